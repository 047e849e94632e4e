"""Typed access to parsed JSON that may come from anywhere: a wrong type is a `CalibrationError`."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError


def parse_json(text: str) -> object:
    """Strict JSON (no NaN or infinity); raises `CalibrationError` on anything else."""
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise CalibrationError("this is no calibration record: it is not valid JSON") from None


class Fields:
    """A JSON object of which each field is asked for with its type.

    Parameters
    ----------
    values
        What the JSON held at this place.
    place
        Where that was, for messages.
    """

    def __init__(self, values: object, place: str) -> None:
        if not isinstance(values, dict):
            raise CalibrationError(f"{place} is not a table of values")
        self._values: dict[str, Any] = values
        self._place = place

    def value(self, key: str) -> Any:
        """Whatever stands there, None when nothing does."""
        return self._values.get(key)

    def text(self, key: str) -> str:
        """A string."""
        value = self.value(key)
        return value if isinstance(value, str) else self._wrong(key, "a text")

    def text_pair(self, key: str) -> tuple[str, str]:
        """Two strings."""
        value = self.value(key)
        if not isinstance(value, list) or len(value) != 2 or not all(isinstance(item, str) for item in value):
            self._wrong(key, "two texts")
        return value[0], value[1]

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self.value(key)
        return value if isinstance(value, bool) else self._wrong(key, "true or false")

    def integer(self, key: str) -> int:
        """A whole number."""
        value = self.value(key)
        return int(value) if _is_integer(value) else self._wrong(key, "a whole number")

    def integers(self, key: str, count: int) -> list[int]:
        """So many whole numbers."""
        value = self.value(key)
        if not isinstance(value, list) or len(value) != count or not all(_is_integer(item) for item in value):
            self._wrong(key, f"{count} whole numbers")
        return list(value)

    def number(self, key: str) -> float:
        """A finite number."""
        value = self.value(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not _is_finite(value):
            self._wrong(key, "a number")
        return float(value)

    def optional_number(self, key: str) -> float | None:
        """A finite number or null."""
        return None if self.value(key) is None else self.number(key)

    def numbers(self, key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Finite numbers of a shape; -1 stands for any length up to 64."""
        try:
            array = np.array(self.value(key), dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            self._wrong(key, "numbers")
        fits = array.ndim == len(shape) and all(
            length == want or (want == -1 and length <= 64)
            for length, want in zip(array.shape, shape, strict=True)
        )
        if not fits or not np.isfinite(array).all():
            self._wrong(key, "finite numbers of the right shape")
        return array

    def optional_numbers(self, key: str, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
        """As `numbers`, or null."""
        return None if self.value(key) is None else self.numbers(key, shape)

    def table(self, key: str) -> Fields:
        """A nested object."""
        return Fields(self.value(key), f"{self._place}.{key}")

    def optional_table(self, key: str) -> Fields | None:
        """A nested object or null."""
        return None if self.value(key) is None else self.table(key)

    def optional_mapping(self, key: str) -> dict[str, Any] | None:
        """A nested object of any plain values, or null."""
        value = self.value(key)
        if value is not None and not isinstance(value, dict):
            self._wrong(key, "a table of values")
        return value

    def tables(self, key: str) -> list[Fields]:
        """A list of objects."""
        value = self.value(key)
        if not isinstance(value, list):
            self._wrong(key, "a list")
        return [Fields(item, f"{self._place}.{key}[{index}]") for index, item in enumerate(value)]

    def _wrong(self, key: str, wanted: str) -> NoReturn:
        raise CalibrationError(
            f"this is no calibration record: {self._place}.{key} is not {wanted}",
            remedy="Give a file made by `thermacq calibrate` or `thermacq calibration rectified`.",
        )


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(name)
