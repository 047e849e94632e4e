"""Pairs of thermal pictures to the shape of the water: matching, triangulation, world frame, elevation grid.

One direction: `open_source` checks a run and its calibration, `find_world_frame` puts the world frame on
the still water, `reconstruct` writes the elevation product, `open_product` and `virtual_probe` read it.
"""

from thermacq.outputs import check_new_file
from thermacq.reconstruction.disparity_errors import (
    DepthErrors,
    DisparityErrors,
    depth_errors,
    disparity_errors,
)
from thermacq.reconstruction.elevation import Reconstructed, parts_folder_of, reconstruct
from thermacq.reconstruction.gridding import Grid, GriddedSurface, grid_over, grid_points
from thermacq.reconstruction.matching import parse_settings
from thermacq.reconstruction.plane import Plane, fit_plane
from thermacq.reconstruction.point_cloud import write_ply
from thermacq.reconstruction.product import VirtualProbe, open_product, virtual_probe
from thermacq.reconstruction.single_pair import (
    MatchedPair,
    load_disparity,
    match_pair,
    save_disparity,
    write_cloud,
)
from thermacq.reconstruction.source import Source, open_source
from thermacq.reconstruction.still_water import check_flat, find_world_frame
from thermacq.reconstruction.triangulation import triangulate
from thermacq.reconstruction.world import WorldFrame, load_world_frame, world_frame

__all__ = [
    "DepthErrors",
    "DisparityErrors",
    "Grid",
    "GriddedSurface",
    "MatchedPair",
    "Plane",
    "Reconstructed",
    "Source",
    "VirtualProbe",
    "WorldFrame",
    "check_flat",
    "check_new_file",
    "depth_errors",
    "disparity_errors",
    "find_world_frame",
    "fit_plane",
    "grid_over",
    "grid_points",
    "load_disparity",
    "load_world_frame",
    "match_pair",
    "open_product",
    "open_source",
    "parse_settings",
    "parts_folder_of",
    "reconstruct",
    "save_disparity",
    "triangulate",
    "virtual_probe",
    "world_frame",
    "write_cloud",
    "write_ply",
]
