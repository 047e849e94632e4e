"""The regular waves of Table II of the paper, by name.

A name holds period and steepness as the paper writes them, e.g. ``T0.791-H2/25`` for T = 0.791 s and
H/λ = 2/25.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

FLUME_DEPTH_M = 0.9
FLUME_WIDTH_M = 1.0
FLUME_LENGTH_M = 20.0

_STEEPNESSES = ("1/16", "2/25", "1/10")
# Period in seconds: heights in cm in the order of _STEEPNESSES (Table II).
_HEIGHTS_CM = {
    "0.553": (3.09, 4.05, 5.23),
    "0.632": (4.04, 5.28, 6.82),
    "0.712": (5.10, 6.67, 8.60),
    "0.791": (6.29, 8.22, 10.58),
    "0.949": (9.03, 11.77),
    "1.186": (13.84,),
}


@dataclass(frozen=True)
class WaveCase:
    """One entry of Table II: period, steepness H/λ, and the height that the paper states."""

    name: str
    period_s: float
    steepness: float
    paper_height_m: float


def _table() -> dict[str, WaveCase]:
    cases = {}
    for period, heights in _HEIGHTS_CM.items():
        for steepness, height_cm in zip(_STEEPNESSES, heights, strict=False):
            name = f"T{period}-H{steepness}"
            cases[name] = WaveCase(name, float(period), float(Fraction(steepness)), height_cm / 100)
    return cases


TABLE_II: dict[str, WaveCase] = _table()
"""All 15 cases by name."""
