"""Ready rig and scene files of the simulated flume, as TOML text."""

from __future__ import annotations

from importlib import resources

from thermacq.errors import RigError
from thermacq_drivers.simflume.cases import TABLE_II

_STILL = """\
# Still water with its thermal texture.
view = "water"
seed = 1
surface = { kind = "still" }
"""

_CHESSBOARD = """\
# A heated chessboard held before the cameras, in another pose every 4 frames.
view = "chessboard"
seed = 1

[chessboard]
columns = 9
rows = 6
square_m = 0.05
frames_per_view = 4
"""

_WAVE = """\
# A regular wave of Table II of the paper: T = {period} s, H/lambda = {steepness}, depth 0.9 m.
view = "water"
seed = 1
depth_m = 0.9

[surface]
kind = "regular"
case = "{name}"
"""


def rig_toml() -> str:
    """The paper's rig, simulated."""
    return resources.files("thermacq_drivers.simflume").joinpath("rig.toml").read_text(encoding="utf-8")


def scene_names() -> list[str]:
    """Names that `scene_toml` knows."""
    return ["still", "chessboard", *TABLE_II]


def scene_toml(name: str) -> str:
    """A scene file: still water, the chessboard, or a case of Table II.

    Raises
    ------
    RigError
        There is no such scene.
    """
    if name in TABLE_II:
        period, steepness = name.removeprefix("T").split("-H")
        return _WAVE.format(name=name, period=period, steepness=steepness)
    if name not in ("still", "chessboard"):
        raise RigError(f"there is no scene '{name}'", remedy=f"Known: {', '.join(scene_names())}.")
    return _STILL if name == "still" else _CHESSBOARD
