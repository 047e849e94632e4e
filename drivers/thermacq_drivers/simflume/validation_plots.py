"""Pictures of the validation page; each shows the simulator against something known."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import welch

from thermacq_drivers.simflume.cases import FLUME_DEPTH_M, TABLE_II
from thermacq_drivers.simflume.correspondence import correspondence
from thermacq_drivers.simflume.diffraction import solve_diffraction
from thermacq_drivers.simflume.dispersion import wavenumber
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.regular_wave import solve_wave
from thermacq_drivers.simflume.scene import WaterView
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.spectra import jonswap
from thermacq_drivers.simflume.surfaces import Floats
from thermacq_drivers.simflume.validation_cameras import NOISE_K, noise_tolerance
from thermacq_drivers.simflume.validation_geometry import (
    WARP_TOLERANCE_K,
    WARPED_SCENES,
    sight_pairs,
    warped_deviations,
)
from thermacq_drivers.simflume.validation_theory import (
    case_wave,
    fenton_profile,
    maccamy_fuchs,
)
from thermacq_drivers.simflume.validation_water import WALL_VALUES, Check, record
from thermacq_drivers.simflume.water import build_water

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermacq_drivers.simflume.validation import Checks

_DPI = 90
_KNOWN: dict[str, Any] = {"color": "0.35", "linewidth": 1.2}
_FOUND: dict[str, Any] = {"color": "C3", "linestyle": "none", "marker": "o", "markersize": 4}
_SHOWN_ROWS = 240
# Of the occlusion; below it there is only water.
_COLOURS = {1 / 16: "C0", 2 / 25: "C1", 1 / 10: "C3"}


def draw_all(checks: Checks, folder: Path) -> list[Path]:
    """Draw all pictures into a folder; returns their paths."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    drawings: dict[str, Callable[[Figure], None]] = {
        "heights": lambda figure: _heights(figure, checks["heights"]),
        "dispersion": _dispersion,
        "profiles": _profiles,
        "drift": lambda figure: _drift(figure, checks["drift"]),
        "sea": _sea,
        "diffraction": _diffraction,
        "noise": lambda figure: _noise(figure, checks["noise"]),
        "rays": lambda figure: _rays(figure, checks["rays"]),
        "warp": _warp,
        "occlusion": _occlusion,
    }
    paths = []
    for name, draw in drawings.items():
        figure = Figure(figsize=(8, 3.6), layout="constrained")
        draw(figure)
        paths.append(folder / f"{name}.png")
        figure.savefig(paths[-1], dpi=_DPI, metadata={"Software": None})
    return paths


def _heights(figure: Figure, checks: Sequence[Check]) -> None:
    axes = figure.subplots()
    deviation = [100 * (check.found / check.known - 1) for check in checks]
    names = [check.name.removeprefix("height of ") for check in checks]
    axes.axhspan(-2, 2, color="0.92", label="2 %")
    axes.axhline(0, **_KNOWN)
    axes.plot(names, deviation, **_FOUND)
    axes.tick_params("x", rotation=70, labelsize=8)
    axes.set(ylabel="height against Table II (%)", ylim=(-3, 3))
    axes.legend(loc="lower right")


def _dispersion(figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    period_s = np.linspace(0.4, 3.2, 200)
    left.plot(period_s, _linear_length(period_s), **_KNOWN, label="ω² = gk tanh kd")
    low = [solve_wave(period, 0.001, FLUME_DEPTH_M) for period in np.linspace(0.5, 3.0, 12)]
    left.plot([w.period_s for w in low], [w.length_m for w in low], **_FOUND, label="waves of H/λ = 0.001")
    left.set(xlabel="period (s)", ylabel="wavelength (m)")
    left.legend()
    theory = np.linspace(0, 0.105, 50)
    # Deep water to the third order: ω² = gk (1 + (ka)²).
    right.plot(theory, 100 * (math.pi * theory) ** 2, **_KNOWN, label="third order, deep water: (ka)²")
    for case in TABLE_II.values():
        wave = case_wave(case)
        excess = 100 * (wave.length_m / float(_linear_length(np.array(wave.period_s))) - 1)
        right.plot(case.steepness, excess, **_FOUND)
    right.set(xlabel="steepness H/λ", ylabel="longer than a low wave (%)", title="the waves of Table II")
    right.legend()


def _linear_length(period_s: Floats) -> Floats:
    """Wavelength of low waves, metres."""
    length: Floats = 2 * math.pi / wavenumber(2 * math.pi / period_s, FLUME_DEPTH_M)
    return length


def _profiles(figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    for steepness, colour in _COLOURS.items():
        case = next(
            case for case in TABLE_II.values() if case.period_s == 0.791 and case.steepness == steepness
        )
        wave = case_wave(case)
        phase = np.linspace(0, 1, 201)
        x_m = phase * wave.length_m
        found, known = wave.elevation(x_m, np.zeros(1), 0.0), fenton_profile(wave, x_m)
        left.plot(phase, known * 100, color=colour, linewidth=1, label=case.name)
        left.plot(phase[::8], found[::8] * 100, "o", color=colour, markersize=3)
        right.plot(phase, (found - known) * 1e6, color=colour, linewidth=1)
    steepest = case_wave(TABLE_II["T0.791-H1/10"]).height_m
    left.plot(phase, 50 * steepest * np.cos(2 * np.pi * phase), ":", color="0.5", label="cosine")
    left.set(xlabel="x/λ", ylabel="elevation (cm)", title="simulator (dots) and raschii, 14 terms")
    left.legend(fontsize=8)
    right.set(xlabel="x/λ", ylabel="difference (µm)")


def _drift(figure: Figure, checks: Sequence[Check]) -> None:
    left, right = figure.subplots(1, 2)
    ka = np.linspace(0, 0.33, 100)
    left.plot(ka, ka**2, **_KNOWN, label="Stokes, deep water: (ka)²")
    waves = [case_wave(case) for case in TABLE_II.values()]
    steepness = [wave.wavenumber_rad_m * wave.height_m / 2 for wave in waves]
    left.plot(steepness, [w.drift_m_s / w.celerity_m_s for w in waves], **_FOUND, label="simulator")
    left.set(xlabel="kH/2", ylabel="drift / celerity", title="the waves of Table II")
    left.legend()
    followed = [check for check in checks if check.name.startswith("drift of a particle")]
    differences = [1e9 * (check.found - check.known) for check in followed]
    right.axhline(0, **_KNOWN)
    right.plot([100 * check.known for check in followed], differences, **_FOUND)
    right.set(xlabel="drift (cm/s)", ylabel="followed particle minus drift (nm/s)")


def _sea(figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    surface = build_water(parse_scene(tomllib.loads(scene_toml("irregular-sea"))))
    time_s = np.arange(0, 1800, 0.1)
    eta_m = record(surface, 0.25, time_s)
    frequency_hz, density = welch(eta_m, fs=10, nperseg=400)
    shown = frequency_hz < 3.5
    line_hz = np.linspace(0.5 / 0.9, 3 / 0.9, 2000)
    shape = jonswap(line_hz, 1 / 0.9)
    shape *= 0.01**2 / (shape.sum() * (line_hz[1] - line_hz[0]))
    left.semilogy(line_hz, shape * 1e4, **_KNOWN, label="JONSWAP, Hm0 = 4 cm")
    label = f"half an hour, Hm0 = {400 * eta_m.std():.3f} cm"
    left.semilogy(frequency_hz[shown], density[shown] * 1e4, color="C3", linewidth=0.8, label=label)
    left.set(xlabel="frequency (Hz)", ylabel="spectrum (cm²/Hz)", ylim=(1e-3, 10))
    left.legend(fontsize=8)
    right.hist(eta_m * 100, bins=60, density=True, color="C3", alpha=0.5, label="simulator")
    level = np.linspace(-4, 4, 200)
    right.plot(level, np.exp(-(level**2) / 2) / math.sqrt(2 * math.pi), **_KNOWN, label="Gaussian, 1 cm")
    right.set(xlabel="elevation (cm)", ylabel="density (1/cm)")
    right.legend(fontsize=8)


def _diffraction(figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    angle_deg = np.linspace(0, 180, 91)
    for colour, ka in zip(("C0", "C1", "C2", "C3", "C4"), WALL_VALUES, strict=True):
        found = np.abs(_open_field(ka, np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))))
        left.plot(angle_deg, found, color=colour, linewidth=1, label=f"ka = {ka:g}")
        left.plot([180, 90, 0], WALL_VALUES[ka], "o", color=colour, markersize=5)
    left.set(xlabel="θ (°), 180: towards the waves", ylabel="|η|/A on the wall", title="published: dots")
    left.legend(fontsize=8)
    for colour, ka in (("C2", 1.0), ("C4", 3.0)):
        for along in (np.linspace(-6, -1, 300), np.linspace(1, 6, 300)):
            right.plot(along, np.abs(_open_field(ka, along, 0 * along)), color=colour, linewidth=1)
        dots = np.concatenate([np.linspace(-6, -1, 26), np.linspace(1, 6, 26)])
        known = maccamy_fuchs(ka, 1.0, np.abs(dots), np.where(dots < 0, math.pi, 0.0))
        right.plot(dots, np.abs(known), "o", color=colour, markersize=3, label=f"series, ka = {ka:g}")
    right.axvspan(-1, 1, color="0.85")
    right.set(xlabel="x/a through the axis", ylabel="|η|/A", title="in the field")
    right.legend(fontsize=8)


def _open_field(ka: float, x: Floats, y: Floats) -> Floats:
    """Complex elevation around a cylinder of radius 1 in open water."""
    return np.asarray(solve_diffraction(ka, 1.0).field(x, y)[0])


def _noise(figure: Figure, checks: Sequence[Check]) -> None:
    axes = figure.subplots()
    prefix = "3-D noise, component "
    found = {c.name.removeprefix(prefix): c for c in checks if c.name.startswith(prefix)}
    axes.axhline(1, **_KNOWN)
    for component, check in found.items():
        name = f"{component} ({1000 * NOISE_K[component]:g} mK)"
        tolerance = noise_tolerance(component)
        axes.errorbar(name, check.found / check.known, tolerance, color="C3", fmt="o", capsize=4)
    axes.set(ylabel="found / set", title="3-D noise of 80 frames; bars: four standard errors, and 0.5 %")


def _rays(figure: Figure, checks: Sequence[Check]) -> None:
    figure.set_figheight(6.5)
    axes = figure.subplots()
    prefix = "rays meet the water, scene "
    rays = [check for check in checks if check.name.startswith(prefix)][::-1]
    worst = [max(check.found, 1e-9) for check in rays]
    axes.barh([check.name.removeprefix(prefix) for check in rays], worst, color="C3")
    axes.axvline(0.001, **_KNOWN)
    axes.set(xscale="log", xlim=(1e-10, 1e-2), xlabel="worst distance between pixel and its water (px)")
    axes.tick_params("y", labelsize=7)
    axes.margins(y=0.01)


def _warp(figure: Figure) -> None:
    axes = figure.subplots()
    shift_px = np.array([-0.2, -0.1, -0.05, -0.02, 0, 0.02, 0.05, 0.1, 0.2])
    for name, scene in WARPED_SCENES.items():
        residual = 1000 * np.array(warped_deviations(scene, shift_px.tolist()))
        axes.plot(shift_px, residual, ".-", linewidth=1, label=name)
    axes.axhline(1000 * WARP_TOLERANCE_K, **_KNOWN)
    axes.set(xlabel="added to the true disparity (px)", ylabel="left minus warped right (mK)", ylim=(0, None))
    axes.legend(fontsize=8)


def _occlusion(figure: Figure) -> None:
    figure.set_figheight(2.2)
    settings = parse_scene(tomllib.loads(scene_toml("two-pairs")))
    panels: Sequence[Axes] = figure.subplots(1, 2)
    left, right = next(sight_pairs(settings, "two-pairs"))
    for axes, title, sight, other in ((panels[0], "left", left, right), (panels[1], "right", right, left)):
        picture = WaterView(settings, sight.camera).temperature(0.43, 0)
        low, high = np.quantile(picture, [0.01, 0.99])
        grey = np.clip((picture - low) / (high - low), 0, 1)[..., None].repeat(3, axis=2)
        truth = correspondence(sight, other.camera, 0.43)
        grey[truth.outside] = 0.5 * grey[truth.outside] + np.array([0.0, 0.15, 0.4])
        grey[truth.occluded] = 1.0, 0.2, 0.1
        axes.imshow(grey[:_SHOWN_ROWS])
        axes.set(title=title, xlabel="column (px)")
