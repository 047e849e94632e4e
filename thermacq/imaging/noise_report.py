"""Noise report of a run that shows a uniform view: 3-D noise, NETD, non-uniformity, spectra, bad pixels.

Two passes over the frames: one finds saturated, constant and bad pixels, the other the noise of the good ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import CorrectionError
from thermacq.imaging.corrections import CorrectedPictures, Corrections, corrections_of
from thermacq.imaging.making import view_of_camera
from thermacq.imaging.references import Reference, frames_of
from thermacq.store import RunFile, open_run
from thermacq_calibration import CameraCorrection
from thermacq_calibration.infrared.bad_pixels import (
    blinking_pixels,
    dead_pixels,
    noisy_pixels,
    outlying_pixels,
)
from thermacq_calibration.infrared.correction import bad_pixel_counts
from thermacq_calibration.infrared.noise import COMPONENTS, Noise3D, NoiseAccumulator
from thermacq_calibration.infrared.noise_figures import (
    Figure,
    Sitf,
    fit_sitf,
    likeness_of_neighbours,
    line_spectrum,
    netd,
    netd_from_differences,
    residual_non_uniformity,
)
from thermacq_calibration.infrared.reference_view import ReferenceView, observe
from thermacq_calibration.infrared.uniformity import correct_mean, large_scale

WANTED_FRAMES = 64
_SPECTRUM_PAIRS = 16
# Drift and 1/f noise raise the noise over that between frames by a few per cent, motion by much more.
_LARGEST_RESTLESSNESS = 1.15
_LARGEST_LIKENESS = 0.2

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power spectral density along rows or columns of a picture, squared counts per cycle per pixel.

    Parameters
    ----------
    frequency
        Cycles per pixel.
    fixed
        Of the mean picture; `temporal` over the number of frames is what noise leaves in it.
    temporal
        Of the differences of successive frames over sqrt(2).
    """

    frequency: Floats
    fixed: Floats
    temporal: Floats


@dataclass(frozen=True, eq=False)
class CameraNoise:
    """Noise of one camera. All in counts; what is in kelvin needs `sitf`.

    Parameters
    ----------
    camera, serial
        Name in the run, and serial number.
    temperature_k
        Of the view; None where it is not known.
    noise
        3-D noise.
    sitf
        Counts per kelvin; None where they are not known. `sitf_from` says whence.
    mean_picture
        (rows, columns) float64, mean over time; bad pixels stand at what their row and column have in common.
    bad_pixels
        (rows, columns) uint8, bits of `BadPixel`; `bad_pixels_from` says whence.
    along_rows, along_columns
        Spectra.
    time_s, fpa_temperature_k, level_counts
        (frames,), the warm-up curve.
    corrected
        Names of the corrections that were applied.
    warnings
        What makes these figures doubtful.
    """

    camera: str
    serial: str
    temperature_k: float | None
    noise: Noise3D
    sitf: Sitf | None
    sitf_from: str
    mean_picture: Floats
    bad_pixels: NDArray[np.uint8]
    bad_pixels_from: str
    along_rows: Spectrum
    along_columns: Spectrum
    time_s: Floats
    fpa_temperature_k: Floats
    level_counts: Floats
    corrected: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def netd_k(self) -> Figure | None:
        """Noise-equivalent temperature difference, kelvin."""
        return None if self.sitf is None else netd(self.noise, self.sitf)

    @property
    def netd_from_differences_k(self) -> Figure | None:
        """The same from differences of successive frames, kelvin."""
        return None if self.sitf is None else netd_from_differences(self.noise, self.sitf)

    @property
    def rnu_k(self) -> Figure | None:
        """Residual non-uniformity of pixels, kelvin."""
        return None if self.sitf is None else residual_non_uniformity(self.noise, self.sitf)

    @property
    def rnu_per_cent(self) -> float:
        """The same in per cent of the mean, whose zero is the camera's arbitrary one."""
        return 100 * self.noise.vh.sigma / abs(self.noise.mean)

    @property
    def large_scale_counts(self) -> float:
        """Peak to peak of the mean picture after a blur of 20 px."""
        return large_scale(self.mean_picture.astype(np.float32))

    def bad_counts(self) -> dict[str, int]:
        """Number of bad pixels by reason; a pixel may have several."""
        return bad_pixel_counts(self.bad_pixels)

    def facts(self) -> dict[str, Any]:
        """Plain values; arrays are left out."""
        components = {}
        for name in COMPONENTS:
            one = self.noise.component(name)
            components[name] = {
                "sigma_counts": one.sigma,
                "low_counts": one.low,
                "high_counts": one.high,
                "variance_counts2": one.variance,
                "variance_is_negative": one.is_negative,
                "sigma_k": one.sigma / self.sitf.counts_per_kelvin if self.sitf else None,
            }
        times, rows, columns = self.noise.shape
        return {
            "camera": self.camera,
            "serial": self.serial,
            "temperature_k": self.temperature_k,
            "frames": times,
            "rows": rows,
            "columns": columns,
            "mean_counts": self.noise.mean,
            "corrections": list(self.corrected),
            "sitf": None if self.sitf is None else {**asdict(self.sitf), "from": self.sitf_from},
            "confidence": self.noise.confidence,
            "noise_3d": components,
            "netd_k": _plain(self.netd_k),
            "netd_from_differences_k": _plain(self.netd_from_differences_k),
            "rnu_k": _plain(self.rnu_k),
            "rnu_per_cent": self.rnu_per_cent,
            "spatial_counts": self.noise.spatial_sigma,
            "large_scale_counts": self.large_scale_counts,
            "bad_pixels": {
                "total": int(np.count_nonzero(self.bad_pixels)),
                **self.bad_counts(),
                "from": self.bad_pixels_from,
            },
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True, eq=False)
class NoiseReport:
    """Noise of all cameras of a run."""

    run: Path
    run_id: str
    simulated: bool
    cameras: tuple[CameraNoise, ...]

    def facts(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "run": str(self.run),
            "run_id": self.run_id,
            "simulated": self.simulated,
            "cameras": [camera.facts() for camera in self.cameras],
        }


def noise_report(
    view: Reference,
    *,
    counts_per_kelvin: float | None = None,
    sitf: Sequence[Reference] = (),
    correction_files: Sequence[Path] = (),
    correct: bool = True,
    confidence: float = 0.95,
) -> NoiseReport:
    """Noise of every camera of a run.

    Parameters
    ----------
    view
        Frames of a uniform view.
    counts_per_kelvin
        Scale, for all cameras. Else from `sitf`, else from the correction.
    sitf
        Uniform views at three temperatures or more, for the scale.
    correction_files, correct
        Corrections to apply, as `corrections_of` takes them; `correct` False: none.
    confidence
        Of the intervals.

    Raises
    ------
    CorrectionError, StoreError
        A run cannot be read, has no such frames, or other cameras.
    thermacq_calibration.CalibrationError
        Frames are too few, saturated or constant; views give no scale.
    """
    if counts_per_kelvin is not None and not counts_per_kelvin > 0:
        raise CorrectionError(f"{counts_per_kelvin:g} counts per kelvin are no scale; it must be above 0")
    with open_run(view.path) as run:
        corrections = corrections_of(run, correction_files, use=correct)
        given = None if counts_per_kelvin is None else Sitf(counts_per_kelvin)
        cameras = tuple(
            _camera(run, name, view, corrections, given, sitf, confidence) for name in run.cameras
        )
        return NoiseReport(run.path, run.header.run_id, run.header.simulated, cameras)


def _camera(
    run: RunFile,
    camera: str,
    reference: Reference,
    corrections: Corrections,
    given: Sitf | None,
    sitf: Sequence[Reference],
    confidence: float,
) -> CameraNoise:
    chosen, temperature_k = frames_of(run, camera, reference)
    table = run.frames(camera)
    # A repeated picture holds no noise of its own.
    is_new = np.concatenate([[True], np.diff(table.crc32.astype(np.int64)) != 0])
    chosen = chosen[is_new[chosen]]
    serial = run.camera(camera).serial
    name = f"{run.path.name}, camera '{camera}'"
    seen = observe((run.counts(camera, int(index)) for index in chosen), temperature_k, name=name)
    corrector = corrections.corrector(camera)
    correction = None if corrector is None else corrections.cameras[camera]
    views = [view_of_camera(one, serial, camera) for one in sitf]
    for view in views:
        if view.mean.shape != seen.mean.shape:
            raise CorrectionError(
                f"{view.label} has pictures of another size than {name}",
                remedy="Give views of one camera in one format.",
            )
    bad, bad_from = _bad_pixels(seen, views, correction)
    scale, scale_from = _scale(given, views, correction, bad)
    accumulator = NoiseAccumulator(bad > 0)
    densities: list[tuple[Floats, Floats]] = []
    level, previous = [], None
    for picture in _pictures(run, camera, chosen, corrections):
        level.append(accumulator.add(picture))
        if previous is not None and len(densities) < _SPECTRUM_PAIRS:
            change = np.where(bad > 0, 0.0, picture.astype(np.float64) - previous) / np.sqrt(2)
            densities.append((line_spectrum(change, 1)[1], line_spectrum(change, 0)[1]))
        previous = picture
    noise = accumulator.noise(confidence)
    along = []
    for axis, temporal in zip((1, 0), zip(*densities, strict=True), strict=True):
        frequency, fixed = line_spectrum(accumulator.mean_picture, axis)
        along.append(Spectrum(frequency, fixed, np.mean(temporal, axis=0)))
    return CameraNoise(
        camera=camera,
        serial=serial,
        temperature_k=temperature_k,
        noise=noise,
        sitf=scale,
        sitf_from=scale_from,
        mean_picture=accumulator.mean_picture,
        bad_pixels=bad,
        bad_pixels_from=bad_from,
        along_rows=along[0],
        along_columns=along[1],
        time_s=(table.host_ns[chosen] - run.header.host_anchor_ns) / 1e9,
        fpa_temperature_k=table.fpa_temperature_k[chosen],
        level_counts=np.array(level),
        corrected=(*(corrector.stages if corrector else ()), *(stage.name for stage in corrections.stages)),
        warnings=_warnings(noise, accumulator.mean_picture),
    )


def _pictures(
    run: RunFile, camera: str, chosen: NDArray[np.intp], corrections: Corrections
) -> Iterator[NDArray[np.uint16] | NDArray[np.float32]]:
    pictures = CorrectedPictures(run, camera, corrections)
    for index in chosen:
        yield pictures.read(int(index))


def _bad_pixels(
    seen: ReferenceView, views: Sequence[ReferenceView], correction: CameraCorrection | None
) -> tuple[NDArray[np.uint8], str]:
    """Map of bad pixels: that of the correction, else what these frames and the views for the scale tell."""
    if correction is not None:
        return correction.bad_pixels, "the correction"
    bad = noisy_pixels(seen) | blinking_pixels(seen)
    known = sorted((view for view in views if view.temperature_k is not None), key=_temperature)
    what = "this run"
    if len(known) > 1:
        bad |= dead_pixels(known[-1].mean - known[0].mean)
        what = "this run and those for the scale"
    return bad | outlying_pixels(seen.mean, bad), what


def _scale(
    given: Sitf | None,
    views: Sequence[ReferenceView],
    correction: CameraCorrection | None,
    bad: NDArray[np.uint8],
) -> tuple[Sitf | None, str]:
    if given is not None:
        return given, "given"
    if views:
        unknown = [view.label for view in views if view.temperature_k is None]
        if unknown:
            raise CorrectionError(
                f"the temperature of {unknown[0]} is not known", remedy="Write RUN@293.15 for 20 °C."
            )
        levels = [
            float(np.mean((view.mean if correction is None else correct_mean(correction, view))[bad == 0]))
            for view in views
        ]
        return fit_sitf([_temperature(view) for view in views], levels), f"{len(views)} views"
    if correction is not None and correction.counts_per_kelvin is not None:
        return Sitf(correction.counts_per_kelvin), "the correction"
    return None, ""


def _temperature(view: ReferenceView) -> float:
    return float("nan") if view.temperature_k is None else view.temperature_k


def _warnings(noise: Noise3D, mean_picture: Floats) -> tuple[str, ...]:
    found = []
    frames = noise.shape[0]
    if frames < WANTED_FRAMES:
        found.append(
            f"{frames} frames are few: record {WANTED_FRAMES} or more, the intervals are wide otherwise."
        )
    restless = noise.tvh.sigma / noise.high_frequency_tvh if noise.high_frequency_tvh > 0 else np.inf
    if restless > _LARGEST_RESTLESSNESS:
        found.append(
            f"The view is not static: its noise is {restless:.2f} times that between successive frames. "
            "Something moves, or pixels drift; this is no noise of the sensor."
        )
    likeness = likeness_of_neighbours(mean_picture)
    if likeness > _LARGEST_LIKENESS and noise.vh.sigma > noise.tvh.sigma / 2:
        found.append(
            f"The view is not uniform: neighbouring pixels are alike (correlation {likeness:.2f}), which the pattern "
            "of a sensor is not. Show a blackbody, the shutter or a cap; non-uniformity is that of the scene."
        )
    return tuple(found)


def _plain(figure: Figure | None) -> dict[str, float] | None:
    return None if figure is None else asdict(figure)
