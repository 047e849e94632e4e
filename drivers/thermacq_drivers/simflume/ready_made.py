"""Ready rig and scene files of the simulated flume, as TOML text."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable

from thermacq.errors import RigError
from thermacq_drivers.simflume.cases import TABLE_II

_WAVE = """\
# A regular wave of Table II of the paper: T = {period} s, H/lambda = {steepness}, depth 0.9 m.
view = "water"
seed = 1
depth_m = 0.9

[surface]
kind = "regular"
case = "{name}"
"""


RIGS = {
    "paper": "rig.toml",
    "two-pairs": "two_pairs.toml",
    "mis-synchronised": "mis_synchronised.toml",
}
"""Ready rigs: names, and their files in this package."""


def rig_toml(name: str = "paper") -> str:
    """A rig file of `RIGS`.

    Raises
    ------
    RigError
        There is no such rig.
    """
    if name not in RIGS:
        raise RigError(f"there is no ready rig '{name}'", remedy=f"Known: {', '.join(RIGS)}.")
    return resources.files("thermacq_drivers.simflume").joinpath(RIGS[name]).read_text(encoding="utf-8")


def scene_summaries() -> dict[str, str]:
    """Scene files that are not of Table II: their names, and what each says of itself in its first line."""
    names = sorted(file.name for file in _scenes().iterdir() if file.name.endswith(".toml"))
    return {
        name.removesuffix(".toml"): _scenes()
        .joinpath(name)
        .read_text(encoding="utf-8")
        .partition("\n")[0]
        .removeprefix("# ")
        for name in names
    }


def scene_names() -> list[str]:
    """Names that `scene_toml` knows."""
    return [*scene_summaries(), *TABLE_II]


def scene_toml(name: str) -> str:
    """A scene file: one of `scene_summaries`, or a case of Table II.

    Raises
    ------
    RigError
        There is no such scene.
    """
    if name in TABLE_II:
        period, steepness = name.removeprefix("T").split("-H")
        return _WAVE.format(name=name, period=period, steepness=steepness)
    if name not in scene_summaries():
        raise RigError(f"there is no scene '{name}'", remedy=f"Known: {', '.join(scene_names())}.")
    return _scenes().joinpath(f"{name}.toml").read_text(encoding="utf-8")


def _scenes() -> Traversable:
    return resources.files("thermacq_drivers.simflume").joinpath("scenes")
