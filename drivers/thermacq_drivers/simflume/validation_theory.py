"""Checks of the simulated waves against second sources: other solvers, other series, particles followed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import h1vp, hankel1, jv, jvp

from thermacq_drivers.simflume.cases import FLUME_DEPTH_M, TABLE_II, WaveCase
from thermacq_drivers.simflume.diffraction import solve_diffraction
from thermacq_drivers.simflume.regular_wave import RegularWave, solve_wave
from thermacq_drivers.simflume.surfaces import Floats
from thermacq_drivers.simflume.validation_water import Check

_FINER_ORDER = 14
_RADIUS_M = 0.1
_TRACKED_PERIODS = 10
_STEPS_PER_PERIOD = 200


def theory_checks() -> list[Check]:
    """All checks of this module."""
    return [
        *(profile_check(case) for case in TABLE_II.values()),
        *field_checks(),
        *(tracking_check(case) for case in TABLE_II.values()),
    ]


def profile_check(case: WaveCase) -> Check:
    """Elevation over a wavelength against raschii's Fenton wave of nearly twice as many terms."""
    wave = case_wave(case)
    x_m = np.linspace(0, wave.length_m, 401)
    known = fenton_profile(wave, x_m)
    worst = float(np.abs(wave.elevation(x_m, np.zeros(1), 0.0) - known).max())
    return Check(f"profile of {case.name}, {_FINER_ORDER} terms", "m", 0.0, worst, 5e-4 * wave.height_m)


def case_wave(case: WaveCase) -> RegularWave:
    """The wave that the simulator uses for a case of Table II."""
    return solve_wave(case.period_s, case.steepness, FLUME_DEPTH_M)


def fenton_profile(wave: RegularWave, x_m: Floats, order: int = _FINER_ORDER) -> Floats:
    """Elevation of raschii's own Fenton wave of this height and length, metres."""
    import raschii

    oracle = raschii.FentonWave(height=wave.height_m, depth=FLUME_DEPTH_M, length=wave.length_m, N=order)
    return np.asarray(oracle.surface_elevation(x_m), np.float64) - FLUME_DEPTH_M


def field_checks() -> list[Check]:
    """|eta|/A around a cylinder in open water against the series of MacCamy and Fuchs, the worst of a ring."""
    angle_rad = np.linspace(0, 2 * math.pi, 73)
    checks = []
    for ka in (0.1, 0.5, 1.0, 2.0, 3.0):
        solution = solve_diffraction(ka / _RADIUS_M, _RADIUS_M)
        for ratio in (1.0, 2.0, 5.0):
            radius_m = ratio * _RADIUS_M
            found = solution.field(radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad))[0]
            known = maccamy_fuchs(ka / _RADIUS_M, _RADIUS_M, np.full(73, radius_m), angle_rad)
            worst = float(np.abs(found - known).max())
            checks.append(Check(f"field at r = {ratio:g} a, ka = {ka:g}", "A", 0.0, worst, 1e-4))
    return checks


def maccamy_fuchs(
    wavenumber_rad_m: float, radius_m: float, distance_m: Floats, angle_rad: Floats
) -> NDArray[np.complex128]:
    """Complex elevation (points,) of a wave of amplitude 1 around a cylinder in open water.

    Σ ε_n i^n [J_n(kr) - J'_n(ka) / H'_n(ka) H_n(kr)] cos nθ, with ε_0 = 1 and else 2, as MacCamy and Fuchs
    (1954) give it.
    """
    kr, ka = wavenumber_rad_m * distance_m, wavenumber_rad_m * radius_m
    total = np.zeros(distance_m.shape, np.complex128)
    for n in range(math.ceil(float(kr.max())) + 25):
        radial = jv(n, kr) - jvp(n, ka) / h1vp(n, ka) * hankel1(n, kr)
        total += (1 if n == 0 else 2) * 1j**n * radial * np.cos(n * angle_rad)
    return total


def tracking_check(case: WaveCase) -> Check:
    """Drift against that of a surface particle followed by Runge-Kutta steps through the velocity."""
    wave = case_wave(case)
    return Check(f"drift of a particle, {case.name}", "m/s", wave.drift_m_s, tracked_drift(wave), 1e-4)


def tracked_drift(wave: RegularWave) -> float:
    """Mean velocity in m/s of a surface particle from crest to crest, over several waves."""
    step_s = wave.period_s / _STEPS_PER_PERIOD
    place, time_s = np.zeros(1), 0.0
    passed = 0.0
    crests: list[tuple[float, float]] = []
    nowhere = np.zeros(1)

    def speed(x_m: Floats, at_s: float) -> Floats:
        return wave.velocity(x_m, nowhere, at_s)[0]

    while len(crests) < _TRACKED_PERIODS:
        first = speed(place, time_s)
        second = speed(place + step_s / 2 * first, time_s + step_s / 2)
        third = speed(place + step_s / 2 * second, time_s + step_s / 2)
        fourth = speed(place + step_s * third, time_s + step_s)
        before, start = time_s, float(place[0])
        place = place + step_s / 6 * (first + 2 * second + 2 * third + fourth)
        time_s += step_s
        # Crests pass a particle when its phase has fallen by a whole turn.
        phase = (wave.celerity_m_s * time_s - float(place[0])) / wave.length_m
        if math.floor(phase) > math.floor(passed):
            part = (math.floor(phase) - passed) / (phase - passed)
            crests.append((before + part * step_s, start + part * (float(place[0]) - start)))
        passed = phase
    time_at, place_at = crests[-1]
    return place_at / time_at
