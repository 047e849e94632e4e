"""The calibration of a wave probe as a hashed JSON record; its history and its drift."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.fields import Fields, parse_json
from thermacq_calibration.files import new_file, read_text
from thermacq_calibration.probes.immersion_steps import StepReading
from thermacq_calibration.probes.probe_line import ProbeLine

FORMAT = "thermacq-probe-calibration"
VERSION = 1
_REMEDY = "Give a file made by `thermacq calibrate probe`."
_MAX_FILE_BYTES = 1 << 22
_COVERAGE = 2.0
"""A change of more than twice its standard uncertainty is called significant."""


@dataclass(frozen=True)
class ProbeCalibration:
    """What one static calibration of a probe gave.

    Parameters
    ----------
    probe, serial, channel, unit
        Which probe and channel, and the unit of its raw values; empty where it is not known.
    steps
        The readings.
    line
        The line through them.
    source
        File that it was made from, and its hash or run.
    created
        UTC time of the record of the steps, ISO 8601, or of the calculation when that is not known.
    """

    probe: str
    serial: str
    channel: str
    unit: str
    steps: tuple[StepReading, ...]
    line: ProbeLine
    source: str
    created: str

    @property
    def sha256(self) -> str:
        """Hash of the content."""
        text = json.dumps(self._content(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, with format, version and hash."""
        return {**self._content(), "sha256": self.sha256}

    def _content(self) -> dict[str, Any]:
        plain = asdict(self)
        plain["steps"] = list(plain["steps"])
        plain["line"]["residuals_m"] = list(plain["line"]["residuals_m"])
        return {"format": FORMAT, "version": VERSION, **plain}

    @classmethod
    def from_dict(cls, values: object) -> ProbeCalibration:
        """Inverse of `to_dict`; raises `CalibrationError` for other values, and for altered ones."""
        record = Fields(values, "probe calibration")
        if record.value("format") != FORMAT or record.value("version") != VERSION:
            raise CalibrationError("this is no probe calibration of a known version", remedy=_REMEDY)
        made = cls(
            steps=tuple(_step(step) for step in record.tables("steps")),
            line=_line(record.table("line")),
            **{
                name: record.text(name)
                for name in ("probe", "serial", "channel", "unit", "source", "created")
            },
        )
        if record.value("sha256") != made.sha256:
            raise CalibrationError(
                "the probe calibration was altered after it was made: its content does not match its hash",
                remedy="Use the original file, or calibrate again.",
            )
        return made

    def save(self, path: Path) -> None:
        """Write a new file; raises `CalibrationError` when it exists or cannot be written."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        with new_file(path):
            path.write_text(text, encoding="utf-8")


def load_probe_calibration(path: Path) -> ProbeCalibration:
    """Read a probe calibration; raises `CalibrationError` when it is missing, foreign, damaged or altered."""
    text = read_text(path, "probe calibration", _MAX_FILE_BYTES, _REMEDY)
    try:
        return ProbeCalibration.from_dict(parse_json(text))
    except CalibrationError as error:
        raise CalibrationError(f"'{path}': {error.what}", remedy=_REMEDY) from None


@dataclass(frozen=True)
class CoefficientSpread:
    """Coefficients of several calibrations of one probe.

    Parameters
    ----------
    count
        Number of calibrations.
    mean_m_per_unit
        Mean coefficient.
    sd_rel
        Standard deviation over the mean (n - 1): what a single calibration is off by, everything that changes
        from one to the next included; NaN for a single one.
    range_rel
        Largest less smallest, over the mean.
    """

    count: int
    mean_m_per_unit: float
    sd_rel: float
    range_rel: float


def coefficient_spread(records: Sequence[ProbeCalibration]) -> CoefficientSpread:
    """Spread of the coefficients of one or more calibrations."""
    values = np.array([record.line.coefficient_m_per_unit for record in records])
    mean = float(values.mean())
    sd = float(values.std(ddof=1)) if values.size > 1 else float("nan")
    return CoefficientSpread(values.size, mean, sd / abs(mean), float(np.ptp(values)) / abs(mean))


@dataclass(frozen=True)
class ProbeDrift:
    """Change of a probe from one calibration to the next; each with its standard uncertainty.

    Parameters
    ----------
    zero_m, zero_u_m
        Change of the raw value of still water, as elevation.
    coefficient_rel, coefficient_u_rel
        Change of the coefficient, relative to the first.
    """

    zero_m: float
    zero_u_m: float
    coefficient_rel: float
    coefficient_u_rel: float

    @property
    def zero_significant(self) -> bool:
        """Whether the zero changed by more than twice the standard uncertainty of the change."""
        return abs(self.zero_m) > _COVERAGE * self.zero_u_m

    @property
    def coefficient_significant(self) -> bool:
        """The same of the coefficient."""
        return abs(self.coefficient_rel) > _COVERAGE * self.coefficient_u_rel


def probe_drift(before: ProbeCalibration, after: ProbeCalibration) -> ProbeDrift:
    """Compare two calibrations of one probe.

    Raises
    ------
    CalibrationError
        They are of different probes, channels or units.
    """
    for what in ("serial", "channel", "unit"):
        one, other = getattr(before, what), getattr(after, what)
        if one and other and one != other:
            raise CalibrationError(
                f"the two calibrations have different {what}s, '{one}' and '{other}'",
                remedy="Compare calibrations of one probe.",
            )
    first, second = before.line, after.line
    coefficient = abs(first.coefficient_m_per_unit)
    return ProbeDrift(
        zero_m=first.coefficient_m_per_unit * (second.zero_raw - first.zero_raw),
        zero_u_m=coefficient * float(np.hypot(first.zero_u_raw, second.zero_u_raw)),
        coefficient_rel=second.coefficient_m_per_unit / first.coefficient_m_per_unit - 1.0,
        coefficient_u_rel=float(np.hypot(first.coefficient_u_rel, second.coefficient_u_rel)),
    )


def _step(step: Fields) -> StepReading:
    return StepReading(
        immersion_m=step.number("immersion_m"),
        raw=step.number("raw"),
        raw_u=step.number("raw_u"),
        start_s=step.number("start_s"),
        stop_s=step.number("stop_s"),
        samples=step.integer("samples"),
    )


def _line(line: Fields) -> ProbeLine:
    optional = {"curvature", "curvature_t", "hysteresis_m"}
    values: dict[str, Any] = {
        field.name: line.optional_number(field.name) if field.name in optional else line.number(field.name)
        for field in fields(ProbeLine)
        if field.name not in ("residuals_m", "degrees_of_freedom")
    }
    residuals = line.numbers("residuals_m", (-1,))
    return ProbeLine(
        **values,
        residuals_m=tuple(float(value) for value in residuals),
        degrees_of_freedom=line.integer("degrees_of_freedom"),
    )
