"""Aravis' fake GigE Vision cameras as peers, started and stopped by their process ids."""

from __future__ import annotations

import errno
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator

import numpy as np
import pytest

from thermacq.devices import DeviceContext, TriggerMode
from thermacq.errors import DeviceOverrun, IncompleteFrame
from thermacq.timing.clock import RealClock
from thermacq_drivers.gige.camera import GigeCamera

PROGRAM = "arv-fake-gv-camera-0.8"
CONTROL_PORT = 3956
SMALL = {"columns": 128, "rows": 96}
_PATIENCE_S = 5.0


def _port_is_free(address: str) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, CONTROL_PORT))
        except OSError as error:
            return error.errno != errno.EADDRINUSE
    return True


class FakeCamera:
    """One fake camera, alive from `start` to `kill`."""

    def __init__(self, address: str, serial: str, lost_per_thousand: int = 0) -> None:
        self.address, self.serial = address, serial
        self._command = [PROGRAM, "-i", address, "-s", serial, "-r", str(lost_per_thousand)]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        if not _port_is_free(self.address):
            pytest.skip(f"another program uses {self.address}:{CONTROL_PORT}")
        self._process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._wait(lambda: not _port_is_free(self.address), "start")

    def signal(self, number: int) -> None:
        assert self._process is not None
        os.kill(self._process.pid, number)

    def kill(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait(_PATIENCE_S)
            self._wait(lambda: _port_is_free(self.address), "let go of its port")

    def _wait(self, condition, what: str) -> None:
        deadline_s = time.monotonic() + _PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline_s, f"{self.serial} did not {what}"
            time.sleep(0.02)


@pytest.fixture(scope="session")
def aravis() -> None:
    """Aravis, its Python binding and its fake camera; without them the reason to skip."""
    from thermacq_drivers.gige.aravis import AravisMissing, load

    if shutil.which(PROGRAM) is None:
        pytest.skip(f"{PROGRAM} is not installed (Debian: aravis-tools)")
    try:
        load()
    except AravisMissing as missing:
        pytest.skip(f"{missing.what}")


@pytest.fixture(scope="session")
def second_address() -> Iterator[str]:
    """A second loopback address; only root may add it."""
    address = "127.0.0.2"
    if shutil.which("ip") is None:
        pytest.skip("the program `ip` is not installed (Debian: iproute2)")
    shown = subprocess.run(["ip", "addr", "show", "dev", "lo"], capture_output=True, text=True, check=False)
    if address in shown.stdout:
        yield address
        return
    change = ["ip", "addr", "add", f"{address}/8", "dev", "lo"]
    added = subprocess.run(change, capture_output=True, text=True, check=False)
    if added.returncode != 0:
        pytest.skip(f"a second loopback address cannot be added: {added.stderr.strip()}")
    yield address
    subprocess.run(["ip", "addr", "del", f"{address}/8", "dev", "lo"], check=False)


@pytest.fixture
def fake_camera(aravis) -> Iterator:
    """Makes fake cameras and takes them away afterwards."""
    made: list[FakeCamera] = []

    def make(serial: str = "GV01", address: str = "127.0.0.1", lost_per_thousand: int = 0) -> FakeCamera:
        made.append(FakeCamera(address, serial, lost_per_thousand))
        made[-1].start()
        return made[-1]

    yield make
    for camera in made:
        camera.kill()


@pytest.fixture
def pair(fake_camera, second_address) -> tuple[FakeCamera, FakeCamera]:
    """Two cameras of the same model."""
    return fake_camera("GV01"), fake_camera("GV02", second_address)


@pytest.fixture
def gige() -> Iterator:
    """Makes driver objects, and closes them."""
    made: list[GigeCamera] = []

    def make(serial: str = "", **settings: object) -> GigeCamera:
        made.append(GigeCamera(DeviceContext("left", RealClock(), serial=serial, settings=settings)))
        return made[-1]

    yield make
    for camera in made:
        camera.close()


class Host:
    """Takes frames as the recorder does: a new generator after each loss, every loss kept."""

    def __init__(self, camera: GigeCamera) -> None:
        declared = camera.capabilities
        self._camera = camera
        self._buffer = np.zeros((declared.rows, declared.columns), np.uint16)
        self.frames: list = []
        self.losses: list = []
        self.until_s = 0.0

    def buffer(self):
        return self._buffer

    def stopping(self) -> bool:
        return time.monotonic() >= self.until_s

    def take(self, number: int, within_s: float = 10.0) -> list:
        """Take frames until there are so many, or the time is over."""
        self.until_s = time.monotonic() + within_s
        wanted = len(self.frames) + number
        generator = self._camera.frames(self)
        while len(self.frames) < wanted:
            try:
                frame = next(generator)
            except StopIteration:
                break
            except (IncompleteFrame, DeviceOverrun) as loss:
                self.losses.append(loss)
                generator = self._camera.frames(self)
                continue
            self.frames.append(frame)
        return self.frames


@pytest.fixture
def running(gige):
    """Makes a camera that runs free, and its host."""

    def make(rate_hz: float = 50.0, serial: str = "", **settings: object) -> tuple[GigeCamera, Host]:
        camera = gige(serial, **settings)
        camera.open()
        camera.configure({**SMALL, **settings})
        camera.arm(TriggerMode.FREE_RUN, rate_hz)
        return camera, Host(camera)

    return make
