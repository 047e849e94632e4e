"""The telemetry row of a FLIR Lepton on a PureThermal board; pure functions.

Row A is the first of the two rows below the picture, in 16-bit words. Decoders differ in which half of a 32-bit
number comes first: `word_order` tells it from two rows, for the milliseconds in them must go on by little. Not
checked on hardware.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

WordOrder: TypeAlias = Literal["low_first", "high_first"]
WORD_ORDERS: tuple[WordOrder, ...] = ("low_first", "high_first")
EXTRA_ROWS = 2

_TIME_MS, _STATUS, _COUNTER, _FPA = 1, 3, 20, 24
_FFC_SHIFT, _FFC_IN_PROGRESS = 4, 2
# Rows of one recording are not further apart; a damaged one is, most likely.
_LONGEST_STEP_MS = 60_000
_COLDEST_K, _HOTTEST_K = 200.0, 400.0
_TURN = 1 << 32


@dataclass(frozen=True)
class LeptonTelemetry:
    """What row A says: time since its start, frame counter, whether the shutter is closed, FPA temperature."""

    time_ms: int
    counter: int
    ffc_in_progress: bool
    fpa_k: float

    def may_follow(self, before: LeptonTelemetry | None) -> bool:
        """Whether this can be the row of a later (or the same) picture: else it is damaged."""
        sensible = _COLDEST_K < self.fpa_k < _HOTTEST_K
        return sensible and (before is None or (self.time_ms - before.time_ms) % _TURN < _LONGEST_STEP_MS)


def read_row(row: NDArray[np.uint16], order: WordOrder) -> LeptonTelemetry:
    """Read row A, (columns,) uint16 with at least 25 columns."""

    def number(place: int) -> int:
        one, two = int(row[place]), int(row[place + 1])
        return two << 16 | one if order == "low_first" else one << 16 | two

    return LeptonTelemetry(
        time_ms=number(_TIME_MS),
        counter=number(_COUNTER),
        ffc_in_progress=number(_STATUS) >> _FFC_SHIFT & 3 == _FFC_IN_PROGRESS,
        fpa_k=int(row[_FPA]) / 100,
    )


def word_order(one: NDArray[np.uint16], two: NDArray[np.uint16]) -> WordOrder | None:
    """Order of the words in which the second row follows the first; None when it does in neither.

    Parameters
    ----------
    one, two
        (columns,) uint16, rows A of two pictures less than 60 s apart, with different times.
    """
    for order in WORD_ORDERS:
        before, after = read_row(one, order), read_row(two, order)
        if after.time_ms != before.time_ms and before.may_follow(None) and after.may_follow(before):
            return order
    return None
