"""Checks of the simulated water against formulas and published values, for tests and the validation page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermacq_drivers.simflume.cases import FLUME_DEPTH_M, FLUME_LENGTH_M, TABLE_II
from thermacq_drivers.simflume.component_sea import ComponentSea
from thermacq_drivers.simflume.diffraction import solve_diffraction
from thermacq_drivers.simflume.regular_wave import GRAVITY_M_S2, solve_wave
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.surfaces import Floats, Surface
from thermacq_drivers.simflume.water import build_water

# |eta|/A on the wall of a cylinder in open water by ka: towards the waves, beside, behind (MacCamy and Fuchs).
WALL_VALUES = {
    0.1: (1.0043, 0.9906, 0.9981),
    0.5: (1.4316, 0.9783, 0.9951),
    1.0: (1.7071, 1.1713, 0.8882),
    2.0: (1.8585, 1.2966, 0.7318),
    3.0: (1.9177, 1.3287, 0.6231),
}
_RECORD_S = 1800.0


@dataclass(frozen=True)
class Check:
    """One comparison: what was compared, the value known, the value found, and how far apart they may be."""

    name: str
    unit: str
    known: float
    found: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether the difference is within the tolerance."""
        return abs(self.found - self.known) <= self.tolerance


def water_checks() -> list[Check]:
    """All checks of this module."""
    return [
        *height_checks(),
        *dispersion_checks(),
        *drift_checks(),
        *energy_checks(),
        *wall_checks(),
        *reflection_checks(),
        seiche_check(),
    ]


def height_checks() -> list[Check]:
    """Heights of Table II of the paper, within 2 %."""
    return [
        Check(
            f"height of {case.name}",
            "m",
            case.paper_height_m,
            solve_wave(case.period_s, case.steepness, FLUME_DEPTH_M).height_m,
            0.02 * case.paper_height_m,
        )
        for case in TABLE_II.values()
    ]


def dispersion_checks() -> list[Check]:
    """Wavelengths of low waves against ω² = g k tanh kd."""
    checks = []
    for period_s in (0.553, 0.791, 1.186, 3.0):
        wave = solve_wave(period_s, 0.001, FLUME_DEPTH_M)
        k = wave.wavenumber_rad_m
        known = 2 * math.pi / math.sqrt(GRAVITY_M_S2 * k * math.tanh(k * FLUME_DEPTH_M))
        checks.append(Check(f"period of a low wave {wave.length_m:.3f} m long", "s", known, period_s, 1e-4))
    return checks


def drift_checks() -> list[Check]:
    """Drift of low waves against Stokes' (ka)² c cosh 2kd / (2 sinh² kd)."""
    checks = []
    for period_s in (0.553, 0.791, 1.186):
        wave = solve_wave(period_s, 0.01, FLUME_DEPTH_M)
        k = wave.wavenumber_rad_m
        kd, ka = k * FLUME_DEPTH_M, k * wave.height_m / 2
        known = ka**2 * wave.celerity_m_s * math.cosh(2 * kd) / (2 * math.sinh(kd) ** 2)
        name = f"drift of a low wave of {period_s} s"
        checks.append(Check(name, "m/s", known, wave.drift_m_s, 0.005 * known))
    return checks


def energy_checks() -> list[Check]:
    """Hm0 of half-hour records of irregular seas against their spectra, within 1 %."""
    checks = []
    for spectrum in ("jonswap", "pierson-moskowitz", "white"):
        surface = build_water(parse_scene({"surface": {"kind": "irregular", "spectrum": spectrum}}))
        eta = record(surface, 0.25, np.arange(0, _RECORD_S, 0.2))
        checks.append(Check(f"Hm0 of a {spectrum} sea", "m", 0.04, 4 * float(eta.std()), 0.0004))
    return checks


def wall_checks() -> list[Check]:
    """Run-up on a cylinder in open water against the published values, to 1e-4."""
    radius_m = 0.1
    checks = []
    for ka, values in WALL_VALUES.items():
        solution = solve_diffraction(ka / radius_m, radius_m)
        for angle_deg, value in zip((180, 90, 0), values, strict=True):
            angle = math.radians(angle_deg)
            x, y = (np.array([radius_m * part]) for part in (math.cos(angle), math.sin(angle)))
            found = float(np.abs(solution.field(x, y)[0])[0])
            checks.append(Check(f"run-up at ka = {ka:g}, θ = {angle_deg}°", "A", value, found, 1e-4))
    return checks


def reflection_checks() -> list[Check]:
    """Reflection coefficients that three wave probes find."""
    checks = []
    for coefficient in (0.05, 0.3):
        scene = {
            "surface": {"kind": "regular", "period_s": 0.8, "steepness": 0.02},
            "reflection": {"coefficient": coefficient},
        }
        length_m = solve_wave(0.8, 0.02, FLUME_DEPTH_M).length_m
        found = reflection_by_three_probes(
            build_water(parse_scene(scene)), 0.8, length_m, [2.0, 2.0 + 0.1 * length_m, 2.0 + 0.27 * length_m]
        )
        checks.append(Check(f"reflection of {coefficient:g}, three probes", "", coefficient, found, 1e-6))
    return checks


def seiche_check() -> Check:
    """Period of the flume's first mode against ω² = g k tanh kd with k = π/L."""
    surface = build_water(parse_scene({"seiche": {}}))
    assert isinstance(surface, ComponentSea)
    k = math.pi / FLUME_LENGTH_M
    known = 2 * math.pi / math.sqrt(GRAVITY_M_S2 * k * math.tanh(k * FLUME_DEPTH_M))
    time_s = np.arange(0, 300, 0.05)
    found = mean_period(time_s, record(surface, 0.0, time_s))
    return Check("period of the seiche", "s", known, found, 1e-3)


def record(surface: Surface, x_m: float, time_s: Floats) -> Floats:
    """Elevation (times,) at one place in the middle of the flume, metres."""
    return surface.elevation(np.full(time_s.size, x_m), np.zeros(time_s.size), time_s)


def mean_period(time_s: Floats, eta_m: Floats) -> float:
    """Mean time between zero up-crossings, interpolated, in seconds."""
    up = np.flatnonzero((eta_m[:-1] < 0) & (eta_m[1:] >= 0))
    crossings = time_s[up] - eta_m[up] * (time_s[up + 1] - time_s[up]) / (eta_m[up + 1] - eta_m[up])
    return float(np.diff(crossings).mean())


def reflection_by_three_probes(
    surface: Surface, period_s: float, length_m: float, places_m: Sequence[float]
) -> float:
    """Reflected over incident amplitude by least squares from wave probes (Mansard and Funke 1980)."""
    time_s = np.arange(20 * 64) / 64 * period_s
    turn = np.exp(2j * math.pi * time_s / period_s)
    first = [(record(surface, x_m, time_s) * turn).mean() for x_m in places_m]
    k = 2 * math.pi / length_m
    travelling = np.exp(1j * np.outer(places_m, [k, -k]))
    incident, reflected = np.linalg.lstsq(travelling, np.array(first), rcond=None)[0]
    return float(abs(reflected) / abs(incident))


def failed(checks: Sequence[Check]) -> list[str]:
    """One line for each check that does not hold."""
    return [
        f"{check.name}: {check.found:g} {check.unit} instead of {check.known:g} +- {check.tolerance:g}"
        for check in checks
        if not check.holds
    ]
