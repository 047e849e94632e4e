"""The straight line of a wave probe: raw values against immersion, with standard errors, and its checks.

Immersion is what is set (a vernier on the probe's holder), raw values are what is read, so raw values are
regressed on immersion and the line is turned round: ``elevation = coefficient * (raw - zero)``. Lowering the
probe by one metre is the same to it as water that rises by one metre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.models import Float
from thermacq_calibration.probes.immersion_steps import StepReading

_LEAST_STEPS = 3


@dataclass(frozen=True)
class ProbeLine:
    """Straight line through the readings of a probe.

    Parameters
    ----------
    coefficient_m_per_unit
        Metres of elevation for one raw unit.
    coefficient_u_rel
        Its relative standard uncertainty: the larger of what the residuals say and what the uncertainties of
        the readings say. The accuracy of the immersions themselves (a ruler that is wrong by a factor) is in
        neither.
    zero_raw, zero_u_raw
        Raw value at immersion 0, and its standard uncertainty.
    residuals_m
        (steps,) reading less line, as elevation.
    rms_residual_m
        Root of the sum of squared residuals over the degrees of freedom (steps - 2).
    linearity
        Largest residual over the span of immersions.
    curvature
        Sag of the best parabola in the middle of the span, over the span; None below four steps.
    curvature_t
        The parabola's coefficient over its standard error; None below four steps.
    hysteresis_m
        Mean residual of steps reached by raising the probe, less that of steps reached by lowering it; None
        unless both happened.
    degrees_of_freedom
        Steps less two.
    """

    coefficient_m_per_unit: float
    coefficient_u_rel: float
    zero_raw: float
    zero_u_raw: float
    residuals_m: tuple[float, ...]
    rms_residual_m: float
    linearity: float
    curvature: float | None
    curvature_t: float | None
    hysteresis_m: float | None
    degrees_of_freedom: int

    @property
    def interval(self) -> float:
        """Half width of the 95 % interval of the coefficient, relative (Student's t)."""
        from scipy.stats import t

        return float(t.ppf(0.975, self.degrees_of_freedom)) * self.coefficient_u_rel


def check_immersions(immersions_m: Float) -> None:
    """Refuse immersions through which no line can be judged.

    Raises
    ------
    CalibrationError
        Fewer than three, not finite, all or neighbouring ones equal, or deeper than a probe is long.
    """
    depths = np.asarray(immersions_m, np.float64)
    problem = ""
    if not np.isfinite(depths).all():
        problem = "an immersion is not a number"
    elif depths.size < _LEAST_STEPS:
        problem = (
            f"{depths.size} immersion{'' if depths.size == 1 else 's'}: a straight line and its error need at "
            f"least {_LEAST_STEPS}"
        )
    elif np.ptp(depths) == 0:
        problem = f"all immersions are {depths[0]:g} m"
    elif (np.diff(depths) == 0).any():
        problem = f"neighbouring immersions are equal ({depths[1:][np.diff(depths) == 0][0]:g} m twice)"
    elif np.unique(depths).size < _LEAST_STEPS:
        problem = "the immersions are only two different depths: a line through them cannot be judged"
    elif np.ptp(depths) > 5:
        problem = f"immersions that span {np.ptp(depths):g} m: they are given in metres"
    if problem:
        raise CalibrationError(
            problem, kept="No file was written.", remedy="Give depths in metres: --immersion 0,0.05,0.1,0.15"
        )


def fit_probe_line(steps: Sequence[StepReading]) -> ProbeLine:
    """Fit the line.

    Parameters
    ----------
    steps
        Readings in the order in which they were taken.

    Raises
    ------
    CalibrationError
        The immersions are unusable (see `check_immersions`), or raw values do not follow them.
    """
    depth, raw, raw_u = (
        np.array([getattr(step, name) for step in steps], np.float64)
        for name in ("immersion_m", "raw", "raw_u")
    )
    if not np.isfinite(raw).all():
        raise CalibrationError("a reading is not a number", kept="No file was written.")
    check_immersions(depth)
    _require_order(depth, raw)
    centred = depth - depth.mean()
    spread = float(centred @ centred)
    slope = float(centred @ raw) / spread
    zero = float(raw.mean() - slope * depth.mean())
    residuals = raw - zero - slope * depth
    freedom = len(steps) - 2
    sigma = float(np.sqrt(residuals @ residuals / freedom))
    to_zero = 1.0 / depth.size - depth.mean() * centred / spread
    slope_u = max(sigma / spread**0.5, float(np.sqrt((centred * raw_u) @ (centred * raw_u))) / spread)
    zero_u = max(
        sigma * float(np.sqrt(to_zero @ to_zero)), float(np.sqrt((to_zero * raw_u) @ (to_zero * raw_u)))
    )
    curvature, curvature_t = _curvature(depth, raw, slope)
    in_metres = residuals / slope
    return ProbeLine(
        coefficient_m_per_unit=1.0 / slope,
        coefficient_u_rel=slope_u / abs(slope),
        zero_raw=zero,
        zero_u_raw=zero_u,
        residuals_m=tuple(float(value) for value in in_metres),
        rms_residual_m=sigma / abs(slope),
        linearity=float(np.abs(in_metres).max() / np.ptp(depth)),
        curvature=curvature,
        curvature_t=curvature_t,
        hysteresis_m=_hysteresis(depth, in_metres),
        degrees_of_freedom=freedom,
    )


def judge_line(line: ProbeLine) -> list[str]:
    """Sentences on what is wrong or weak about a line; empty when nothing is."""
    from scipy.stats import t

    found = []
    if line.coefficient_u_rel > 0.01:
        found.append(f"the coefficient is known to {100 * line.coefficient_u_rel:.1f} % only; 0.5 % is usual")
    if line.curvature is not None and line.curvature_t is not None and line.degrees_of_freedom > 1:
        limit = float(t.ppf(0.995, line.degrees_of_freedom - 1))
        if abs(line.curvature_t) > limit and abs(line.curvature) > 0.002:
            found.append(
                f"the probe is not linear: it bends by {100 * abs(line.curvature):.2f} % of the span; "
                "use less of its length, or calibrate over the range of the waves only"
            )
    if line.hysteresis_m is not None and abs(line.hysteresis_m) > max(3e-4, 2 * line.rms_residual_m):
        found.append(
            f"it reads {1000 * abs(line.hysteresis_m):.2f} mm differently after raising and after lowering: "
            "a meniscus or a dirty rod"
        )
    return found


def _require_order(depth: Float, raw: Float) -> None:
    """Every deeper reading must differ from every shallower one in the same direction."""
    deeper = np.subtract.outer(depth, depth) > 0
    higher = np.sign(np.subtract.outer(raw, raw))
    rising = int(np.count_nonzero(higher[deeper] > 0))
    falling = int(np.count_nonzero(higher[deeper] < 0))
    wrong = deeper & (higher != (1 if rising >= falling else -1))
    if not wrong.any():
        return
    one, other = (int(index) + 1 for index in np.argwhere(wrong)[0])
    raise CalibrationError(
        f"the raw values do not follow the immersions: step {one} ({depth[one - 1]:g} m) reads {raw[one - 1]:.5g} "
        f"and step {other} ({depth[other - 1]:g} m) {raw[other - 1]:.5g}, against the trend of the others",
        kept="No file was written.",
        remedy="List the immersions in the order of the record; a probe that turns back is at its end or broken.",
    )


def _curvature(depth: Float, raw: Float, slope: float) -> tuple[float | None, float | None]:
    if np.unique(depth).size < 4:
        return None, None
    middle, half = (depth.max() + depth.min()) / 2, np.ptp(depth) / 2
    design = np.vander((depth - middle) / half, 3)
    solution, *_ = np.linalg.lstsq(design, raw, rcond=None)
    residuals = raw - design @ solution
    variance = float(residuals @ residuals) / (depth.size - 3)
    error = float(np.sqrt(variance * np.linalg.inv(design.T @ design)[0, 0]))
    sag = float(solution[0] / slope / (2 * half))
    return sag, float(solution[0]) / error if error > 0 else 0.0


def _hysteresis(depth: Float, residuals_m: Float) -> float | None:
    moved = np.diff(depth)
    raised, lowered = residuals_m[1:][moved < 0], residuals_m[1:][moved > 0]
    return float(raised.mean() - lowered.mean()) if raised.size and lowered.size else None
