"""Hosts, small cameras and scenes that the tests of the simulated flume share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thermacq.devices import DeviceContext
from thermacq.timing import Clock, VirtualClock
from thermacq_drivers.simflume.mounting import Mounting

# The field of view of the paper's cameras on a quarter of the pixels along each axis.
SMALL = {"rows": 128, "columns": 160, "pixel_pitch_um": 68.0}
WAVE = {"surface": {"kind": "regular", "case": "T0.791-H2/25"}}


class Host:
    """The host's side of a generator; `stop_after` ends it at that many looks at `stopping`."""

    def __init__(self, rows: int = SMALL["rows"], columns: int = SMALL["columns"]) -> None:
        self.shape = rows, columns
        self.stop = False
        self.stop_after = -1

    def stopping(self) -> bool:
        self.stop_after -= 1
        return self.stop or self.stop_after == -1

    def buffer(self) -> np.ndarray:
        return np.empty(self.shape, np.uint16)


@pytest.fixture
def host() -> Host:
    return Host()


@pytest.fixture
def small() -> dict[str, Any]:
    """Settings of a small camera."""
    return dict(SMALL)


@pytest.fixture
def wave() -> dict[str, Any]:
    """Scene of the demo's wave."""
    return dict(WAVE)


@pytest.fixture
def small_mounting() -> Callable[..., Mounting]:
    return lambda **changes: Mounting.model_validate({**SMALL, **changes})


@pytest.fixture
def context(tmp_path: Path) -> Callable[..., DeviceContext]:
    """Make the context of a device; virtual time unless a clock is given."""

    def make(
        name: str = "left", scene: dict[str, Any] | None = None, clock: Clock | None = None
    ) -> DeviceContext:
        return DeviceContext(name, clock or VirtualClock(), scene or {}, tmp_path)

    return make
