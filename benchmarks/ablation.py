"""What each correction of the pictures does to the reconstructed surface, on the simulator's truth.

Geometry and world frame are the true ones, so that rows of a scene differ by the pictures alone. Each run of
the simulator begins at time 0, and its 1/f noise is a function of time: so reference views lie at least 5 s
from the water, or noise that both saw would be taken away too well. Writes its table into
``docs/explanation/correction-ablation.md``.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.acquisition import record
from thermacq.errors import ReconstructionError
from thermacq.evaluation.flatness import flatness
from thermacq.hooks import TruthRequest
from thermacq.imaging import NO_CORRECTIONS, Corrections, Stage
from thermacq.imaging.making import make_corrections, update_correction
from thermacq.imaging.references import parse_reference
from thermacq.plugins import plugins
from thermacq.reconstruction import (
    Source,
    WorldFrame,
    open_product,
    open_source,
    parts_folder_of,
    reconstruct,
)
from thermacq.rig import Rig
from thermacq.store import open_run
from thermacq_calibration import CameraCorrection, CameraModel, StereoCalibration
from thermacq_drivers.simflume.ready_made import rig_toml, scene_toml

PAGE = Path(__file__).parents[1] / "docs" / "explanation" / "correction-ablation.md"
BEGIN, END = "<!-- table made by `python -m benchmarks ablation` -->", "<!-- end of the table -->"
PAIRS = 24
RANGE = {"min_disparity": 40, "max_disparity": 96}
REFERENCE_RATE_HZ = 2.0
FRAMES_EACH = 64
TEMPERATURES_K = (295.0, 290.0, 300.0, 285.0, 305.0, 295.0)
"""The first, which begins 5 s from the water, brings offsets up to date; the last judges, two minutes later."""
FIRST_FRAME = 10
WAVE = {"kind": "regular", "case": "T0.791-H2/25"}
EVEN = {"netd_k": 0.035, "offset_k": 0.0, "gain": 0.0, "shading_k": 0.0, "bad_pixel_fraction": 0.0}


@dataclass(frozen=True)
class Water:
    """A scene to reconstruct: its name on the page, whose cameras see it, which water, and how often.

    `cameras` are those of a ready scene, with changes of their sensors.
    """

    title: str
    cameras: tuple[str, dict[str, float]]
    surface: dict[str, Any]
    rate_hz: float


@dataclass(frozen=True)
class Outcome:
    """One row of the table; metres."""

    scene: str
    stage: str
    single_m: float
    mean_m: float
    error_m: float
    median_error_m: float
    supported: float


DEMO: tuple[str, dict[str, float]] = ("still", {})
DIRTY: tuple[str, dict[str, float]] = ("dirty-sensor", {})
STEADY: tuple[str, dict[str, float]] = ("dirty-sensor", {"flicker_k": 0.0, "column_flicker_k": 0.0})
STILL = {"kind": "still"}
WATERS = (
    Water("demo cameras, still water, 50 Hz", DEMO, STILL, 50.0),
    Water("demo cameras, still water, 1 Hz", DEMO, STILL, 1.0),
    Water("dirty sensor, still water, 50 Hz", DIRTY, STILL, 50.0),
    Water("dirty sensor without 1/f noise, still water, 50 Hz", STEADY, STILL, 50.0),
    Water("dirty sensor, wave, 50 Hz", DIRTY, WAVE, 50.0),
)


def run() -> list[dict[str, Any]]:
    """Record, correct, reconstruct and compare; returns the benchmark's rows."""
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as folder:
        made: dict[str, dict[str, dict[str, CameraCorrection]]] = {}
        for water in WATERS:
            kind = str(water.cameras)
            made[kind] = made.get(kind) or _corrections(water.cameras, Path(folder))
            outcomes += _ablate(water, made[kind], Path(folder))
    _write_page(outcomes)
    return [
        {"name": f"{one.scene}: {one.stage}: {what}", "value": 1000 * value, "unit": "mm"}
        for one in outcomes
        for what, value in (("single-frame sigma", one.single_m), ("error", one.error_m))
        if one.supported > 0
    ]


def _ablate(water: Water, made: dict[str, dict[str, CameraCorrection]], folder: Path) -> list[Outcome]:
    path = _record(_scene(water.cameras, surface=water.surface), water.rate_hz, PAIRS, folder / "water.h5")
    truth = _Truth.of(path)
    source = open_source(path, calibration=truth.save_calibration(folder), settings=RANGE, correct=False)
    outcomes = []
    for stage, corrections in _variants(made):
        outcomes.append(_measure(water.title, stage, replace(source, corrections=corrections), truth, folder))
    path.unlink()
    even = _scene(water.cameras, surface=water.surface)
    even["camera"] = {**even.get("camera", {}), "sensor": EVEN}
    if "lens" in even["camera"]:
        even["camera"]["lens"] = {**even["camera"]["lens"], "vignetting": 0.0, "narcissus": 0.0}
    ideal = _record(even, water.rate_hz, PAIRS, path)
    source = open_source(ideal, calibration=folder / "true.json", settings=RANGE, correct=False)
    outcomes.append(_measure(water.title, "an even sensor with the same noise", source, truth, folder))
    ideal.unlink()
    return outcomes


def _variants(made: dict[str, dict[str, CameraCorrection]]) -> list[tuple[str, Corrections]]:
    """The rows of the table: each stage on top of those before it."""
    off = {"bad_pixels": False, "shading": False}
    settings = plugins().correction_stage("destriping").settings()

    def striped(**changes: Any) -> Corrections:
        stage = Stage("destriping", settings(**changes).model_dump())
        return Corrections(made["updated"], "files", stages=(stage,))

    return [
        ("as delivered", NO_CORRECTIONS),
        ("one-point at 290 K", Corrections(made["one-point"], "files", **off)),
        ("two-point, 285 and 305 K", Corrections(made["wide"], "files", **off)),
        ("two-point, 290 and 300 K", Corrections(made["narrow"], "files", **off)),
        ("+ bad pixels", Corrections(made["narrow"], "files", shading=False)),
        ("+ shading", Corrections(made["shaded"], "files")),
        ("+ offsets updated at 295 K", Corrections(made["updated"], "files")),
        ("+ destriping", striped()),
        ("+ destriping, no gate, no memory", striped(memory_pictures=0, min_motion=0.0)),
    ]


def _corrections(
    cameras: tuple[str, dict[str, float]], folder: Path
) -> dict[str, dict[str, CameraCorrection]]:
    """Corrections of both cameras from simulated blackbody views, by how they were made."""
    frames = FRAMES_EACH * len(TEMPERATURES_K)
    path = _record(_blackbody(cameras), REFERENCE_RATE_HZ, frames, folder / "views.h5")
    at = {kelvin: parse_reference(f"{path}@{kelvin}") for kelvin in (285, 305, 290, 300)}
    near = parse_reference(f"{path}@295@{FIRST_FRAME}:{FRAMES_EACH}")
    last = parse_reference(f"{path}@295@{frames - FRAMES_EACH}:{frames}")
    made = {
        "one-point": make_corrections(at[290]),
        "wide": make_corrections(at[285], at[305], check=last),
        "narrow": make_corrections(at[290], at[300], check=last),
        "shaded": make_corrections(at[290], at[300], check=last, uniform=last),
    }
    records = {how: {name: one.correction for name, one in by.items()} for how, by in made.items()}
    records["updated"] = {
        name: update_correction(record, near, behind_lens=False) for name, record in records["shaded"].items()
    }
    path.unlink()
    return records


def _scene(cameras: tuple[str, dict[str, float]], **changes: Any) -> dict[str, Any]:
    name, sensor = cameras
    scene = {**tomllib.loads(scene_toml(name)), **changes}
    if sensor:
        scene["camera"] = {**scene["camera"], "sensor": {**scene["camera"]["sensor"], **sensor}}
    return scene


def _blackbody(cameras: tuple[str, dict[str, float]]) -> dict[str, Any]:
    uniform = {"temperatures_k": list(TEMPERATURES_K), "frames_per_temperature": FRAMES_EACH}
    return _scene(cameras, view="uniform", surface=STILL, uniform=uniform)


def _record(scene: dict[str, Any], rate_hz: float, frames: int, path: Path) -> Path:
    values = tomllib.loads(rig_toml())
    values["scene"] = scene
    values["trigger"]["frame_rate_hz"] = rate_hz
    record(Rig.model_validate(values), path, frames=frames)
    return path


@dataclass(frozen=True)
class _Truth:
    """What the simulator knows of a run."""

    run: Path
    facts: dict[str, Any]

    @classmethod
    def of(cls, path: Path) -> _Truth:
        with open_run(path) as run:
            request = TruthRequest(
                scene=run.header.rig["scene"],
                time_s=np.zeros(1),
                x_m=np.zeros(1),
                y_m=np.zeros(1),
                rig=run.header.rig,
            )
        truth = plugins().truth(request)
        assert truth is not None
        return cls(path, {**truth.facts["calibration"], "request": request})

    def save_calibration(self, folder: Path) -> Path:
        path = folder / "true.json"
        path.unlink(missing_ok=True)
        self.calibration().save(path)
        return path

    def calibration(self) -> StereoCalibration:
        left, right = (
            CameraModel(np.array(self.facts[side]["matrix"]), np.array(self.facts[side]["distortion"]))
            for side in ("left", "right")
        )
        return StereoCalibration(
            tuple(self.facts["image_size"]),
            left,
            right,
            np.array(self.facts["rotation"]),
            np.array(self.facts["translation_m"]),
            source="simulated truth",
        )

    def world(self, source: Source) -> WorldFrame:
        pose = self.facts["left_camera_to_world"]
        return WorldFrame(
            np.array(pose["rotation"]) @ source.rectification.rotation_left.T,
            np.array(pose["translation_m"]),
            0.0,
            0.0,
            np.zeros((3, 3)),
            0,
            0,
            {"from": "simulated truth", "calibration_sha256": source.calibration.sha256},
        )

    def elevation(self, time_s: NDArray[Any], x_m: NDArray[Any], y_m: NDArray[Any]) -> NDArray[np.float64]:
        truth = plugins().truth(replace(self.facts["request"], time_s=time_s, x_m=x_m, y_m=y_m))
        assert truth is not None
        return truth.eta_m


def _measure(scene: str, stage: str, source: Source, truth: _Truth, folder: Path) -> Outcome:
    output = folder / "eta.nc"
    output.unlink(missing_ok=True)
    cores = len(os.sched_getaffinity(0))
    try:
        result = reconstruct(
            source, output, world=truth.world(source), workers=cores, progress=lambda *_: None
        )
    except ReconstructionError:
        shutil.rmtree(parts_folder_of(output), ignore_errors=True)
        return Outcome(scene, stage, *[float("nan")] * 4, 0.0)
    with open_product(output) as product:
        eta = product["eta"].to_numpy().astype(np.float64)
        time_s, x_m, y_m = (product[name].to_numpy().astype(np.float64) for name in ("time", "x", "y"))
    error = eta - truth.elevation(time_s, x_m, y_m)
    flat = flatness(error, x_m, y_m)
    known = error[np.isfinite(error)]
    return Outcome(
        scene,
        stage,
        flat.overall_sd_m,
        flat.fixed_sd_m,
        float(np.sqrt(np.mean(known**2))),
        float(np.median(np.abs(known))),
        result.supported_share * float(np.isfinite(error).any(axis=0).mean()),
    )


def _write_page(outcomes: Sequence[Outcome]) -> None:
    lines = []
    for scene in dict.fromkeys(one.scene for one in outcomes):
        lines += [
            f"**{scene[0].upper()}{scene[1:]}**",
            "",
            "| pictures | σ, single frames | σ, mean of all frames | RMS error | median of errors' size | cells |",
            "|---|---|---|---|---|---|",
        ]
        for one in outcomes:
            if one.scene == scene:
                figures = (one.single_m, one.mean_m, one.error_m, one.median_error_m)
                cells = " | ".join(
                    f"{1000 * value:.3f}" if one.supported > 0 else "none" for value in figures
                )
                lines.append(f"| {one.stage} | {cells} | {100 * one.supported:.1f} % |")
        lines.append("")
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    table = "\n".join(lines)
    PAGE.write_text(f"{before}{BEGIN}\n\n{table}{END}{after}", encoding="utf-8")
