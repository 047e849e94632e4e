"""Point clouds as binary PLY, which CloudCompare, MeshLab and Open3D open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def write_ply(path: Path, points: NDArray[Any], colours: NDArray[np.uint8] | None = None) -> int:
    """Write points that are finite.

    Parameters
    ----------
    path
        File to write.
    points
        (..., 3), metres; rows with NaN are left out.
    colours
        (..., 3) uint8, red, green, blue, one for each point.

    Returns
    -------
    int
        Number of points written.
    """
    flat = points.reshape(-1, 3)
    finite = np.isfinite(flat).all(axis=1)
    fields: list[tuple[str, str]] = [(name, "<f4") for name in "xyz"]
    header = [f"property float {name}" for name in "xyz"]
    if colours is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    vertices = np.empty(int(finite.sum()), dtype=fields)
    for index, name in enumerate("xyz"):
        vertices[name] = flat[finite, index]
    if colours is not None:
        for index, name in enumerate(("red", "green", "blue")):
            vertices[name] = colours.reshape(-1, 3)[finite, index]
    lines = ["ply", "format binary_little_endian 1.0", "comment metres", f"element vertex {len(vertices)}"]
    with path.open("wb") as file:
        file.write(("\n".join([*lines, *header, "end_header"]) + "\n").encode("ascii"))
        file.write(vertices.tobytes())
    return len(vertices)
