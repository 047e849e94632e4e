"""Pictures per second through the infrared correction, against one multiply-add pass of OpenCV.

Pictures are 640 x 512 uint16 of two cameras in memory, 0.5 % of the pixels bad. One thread per process; two
cameras are corrected by two processes at the same time. The temperature of the camera wanders by its reading's
noise, so that the shading is folded in anew now and then.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from thermacq_calibration import CameraCorrection, Corrector

ROWS, COLUMNS = 512, 640
PICTURES = 16
SECONDS = 2.0
WANTED_PER_S = 400.0


def run() -> list[dict[str, Any]]:
    """Measure and return rows: name, value, unit, baseline, ratio."""
    floor = _speed(_floor(*_camera(0)))
    baseline = "cv2.multiply and cv2.add, one thread"
    stages = {
        "non-uniformity": {"bad_pixels": False, "shading": False},
        "non-uniformity and shading": {"bad_pixels": False},
        "non-uniformity, shading and bad pixels": {},
    }
    rows: list[dict[str, Any]] = [
        {"name": baseline, "value": floor, "unit": "pictures/s", "baseline": "", "ratio": None}
    ]
    for name, without in stages.items():
        correction, counts = _camera(0)
        speed = _speed(_step(Corrector(correction, **without), counts))
        rows.append(
            {
                "name": f"{name}, one camera",
                "value": speed,
                "unit": "pictures/s",
                "baseline": baseline,
                "ratio": speed / floor,
            }
        )
    both = _both_cameras()
    rows.append(
        {
            "name": "all three, two cameras in two processes",
            "value": both,
            "unit": "pictures/s",
            "baseline": f"{WANTED_PER_S:.0f} pictures/s",
            "ratio": both / WANTED_PER_S,
        }
    )
    return rows


def _camera(seed: int) -> tuple[CameraCorrection, list[NDArray[np.uint16]]]:
    """A correction and pictures of one camera."""
    random = np.random.default_rng(seed)
    shape = ROWS, COLUMNS
    correction = CameraCorrection(
        serial=f"B-{seed}",
        camera="left",
        gain=random.normal(1, 0.03, shape),
        offset=random.normal(0, 200, shape),
        bad_pixels=(random.random(shape) < 0.005).astype(np.uint8),
        shading=random.normal(0, 20, shape),
        shading_temperature_k=307.0,
        shading_zero_k=305.0,
    )
    return correction, [random.integers(4000, 9000, shape).astype(np.uint16) for _ in range(PICTURES)]


def _step(corrector: Corrector, counts: list[NDArray[np.uint16]]) -> Callable[[int], object]:
    out = np.empty((ROWS, COLUMNS), np.float32)
    inside_k = np.random.default_rng(1).normal(306, 0.005, 256)
    return lambda number: corrector(counts[number % PICTURES], float(inside_k[number % 256]), out)


def _floor(correction: CameraCorrection, counts: list[NDArray[np.uint16]]) -> Callable[[int], object]:
    out = np.empty((ROWS, COLUMNS), np.float32)
    gain, offset = correction.gain.copy(), correction.offset.copy()

    def step(number: int) -> None:
        cv2.multiply(counts[number % PICTURES], gain, dst=out, dtype=cv2.CV_32F)
        cv2.add(out, offset, dst=out)

    return step


def _both_cameras() -> float:
    """Pictures of both cameras per second, while both processes are at work."""
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        start_at = time.time() + 3.0
        return sum(pool.map(_camera_speed, (0, 1), (start_at, start_at)))


def _camera_speed(seed: int, start_at: float) -> float:
    correction, counts = _camera(seed)
    step = _step(Corrector(correction), counts)
    step(0)
    time.sleep(max(0.0, start_at - time.time()))
    return _count(step, SECONDS) / SECONDS


def _speed(step: Callable[[int], object]) -> float:
    """Calls per second, best of three rounds: other work on the machine only ever slows down."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return max(_count(step, SECONDS / 4) / (SECONDS / 4) for _ in range(3))
    finally:
        cv2.setNumThreads(threads)


def _count(step: Callable[[int], object], seconds: float) -> int:
    """How many calls begin within so many seconds."""
    end = time.perf_counter() + seconds
    number = 0
    while time.perf_counter() < end:
        step(number)
        number += 1
    return number
