"""A sheet of simulated pictures to compare with the paper's Figs. 1, 7, 8 and 10."""

from __future__ import annotations

import tempfile
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from thermacq.devices import DeviceContext, TriggerMode
from thermacq.timing import NS_PER_S, VirtualClock
from thermacq_drivers.simflume.camera import CameraSettings, SimulatedCamera
from thermacq_drivers.simflume.correspondence import Correspondence, correspondence
from thermacq_drivers.simflume.mounting import build_camera
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.sight import build_sight

_TIME_S = 0.3
_COLUMNS = 4
_PANEL_INCHES = (2.9, 2.5)
_DOTS_PER_INCH = 100
_GREYS = 52
_DOWNSTREAM: dict[str, Any] = {"x_m": 0.84, "y_m": -0.06, "azimuth_deg": 180.0}

Picture = NDArray[np.float32]


def draw_contact_sheet(path: Path) -> None:
    """Draw the sheet into a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    panels = _panels()
    rows = -(-len(panels) // _COLUMNS)
    size = (_COLUMNS * _PANEL_INCHES[0], rows * _PANEL_INCHES[1])
    figure = Figure(size, dpi=_DOTS_PER_INCH, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(rows, _COLUMNS)
    for axis, (title, picture, limits) in zip(axes.flat, panels, strict=True):
        low, high = limits or np.nanpercentile(picture, [0.5, 99.5])
        axis.imshow(picture, cmap="gray", vmin=low, vmax=high, interpolation="antialiased")
        axis.set_title(title, fontsize=8)
        axis.set_axis_off()
    canvas.draw()  # type: ignore[no-untyped-call]
    drawn = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    image = Image.fromarray(drawn[..., :3])
    image.convert("L").quantize(_GREYS).save(path, optimize=True)


def _panels() -> list[tuple[str, Picture, tuple[float, float] | None]]:
    """Title, picture and limits of each panel."""
    wave, cylinder = _scene("paper-wave"), _scene("paper-cylinder")
    behind = _scene("two-pairs")
    left, right = _counts(cylinder, side="left"), _counts(cylinder, side="right")
    truth = _truth(cylinder)
    places = truth.column_px.astype(np.float32), truth.row_px.astype(np.float32)
    warped = np.asarray(cv2.remap(right, *places, cv2.INTER_CUBIC), np.float32)
    disparity = truth.disparity_px.astype(np.float32)
    for picture in (warped, disparity):
        picture[truth.occluded | truth.outside] = np.nan
    return [
        ("regular wave, left (Figs. 1b, 8a)", _counts(wave, side="left"), None),
        ("regular wave, right (Fig. 8b)", _counts(wave, side="right"), None),
        ("cylinder, left (Fig. 8c)", left, None),
        ("cylinder, right (Fig. 8d)", right, None),
        ("right picture, reprojected to the left (cf. Fig. 10)", warped, None),
        ("left minus reprojected, ±0.5 K", left - warped, (-50.0, 50.0)),
        ("true disparity; white: not seen by both", disparity, (50.0, 110.0)),
        ("chessboard (Fig. 7b)", _counts(_scene("chessboard"), index=12, side="left"), None),
        ("downstream pair, left", _counts(behind, side="left", **_DOWNSTREAM), None),
        ("downstream pair, right", _counts(behind, side="right", **_DOWNSTREAM), None),
        ("poor texture", _counts(_scene("poor-texture"), side="left"), None),
        ("lamps on the wrong side", _counts(_scene("lamp-reflection"), side="left"), None),
    ]


def _scene(name: str) -> dict[str, Any]:
    return tomllib.loads(scene_toml(name))


def _counts(scene: dict[str, Any], index: int = 0, **settings: Any) -> Picture:
    """What a camera delivers of a scene at one trigger, as float32 counts; 100 of them are 1 K."""
    clock = VirtualClock()
    with tempfile.TemporaryDirectory() as folder:
        camera = SimulatedCamera(DeviceContext(settings["side"], clock, scene, Path(folder)))
        camera.open()
        camera.configure(settings)
        camera.arm(TriggerMode.SOFTWARE, 50.0)
        clock.wait_until_ns(round(_TIME_S * NS_PER_S))
        camera.trigger(index)
        frame = next(camera.frames(_Host()))
        camera.close()
    return frame.counts.astype(np.float32)


class _Host:
    """The host's side of one camera."""

    def stopping(self) -> bool:
        return False

    def buffer(self) -> NDArray[np.uint16]:
        settings = CameraSettings()
        return np.empty((settings.rows, settings.columns), np.uint16)


def _truth(scene: dict[str, Any]) -> Correspondence:
    checked = parse_scene(scene)
    left, right = (build_camera(CameraSettings.model_validate({"side": side})) for side in ("left", "right"))
    return correspondence(build_sight(checked, build_surface(checked), left), right, _TIME_S)
