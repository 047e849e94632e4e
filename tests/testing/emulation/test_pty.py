"""An emulated serial port under the real pyserial: bytes, faults of the wire, unplugging."""

from __future__ import annotations

import time

import pytest
import serial

from thermacq.testing.emulation.faults import FaultSchedule, FaultSettings
from thermacq.testing.emulation.pty import PtyPort
from thermacq.timing.clock import RealClock
from thermacq.transports import SerialNode


class Echo:
    """Answers each byte by the byte after it."""

    def __init__(self):
        self.lives = 0

    def power_up(self):
        self.lives += 1

    def receive(self, data):
        return [bytes([(byte + 1) % 256]) for byte in data]

    def due_ns(self):
        return None

    def act(self):
        return ()


@pytest.fixture
def plug():
    clock = RealClock()
    ports = []

    def make(*faults):
        schedule = FaultSchedule([FaultSettings(**fault) for fault in faults], clock)
        port = PtyPort(Echo(), SerialNode("", 1, 2, "S"), clock, schedule)
        ports.append(port.__enter__())
        return port, schedule

    yield make
    for port in ports:
        port.__exit__(None, None, None)


def ask(path, data, answer_bytes):
    with serial.Serial(path, timeout=0.3) as port:
        port.write(data)
        return port.read(answer_bytes)


def test_bytes_pass_both_ways(plug):
    port, _ = plug()
    assert ask(port.node().path, b"\x00\x0a\xff\x13", 4) == b"\x01\x0b\x00\x14"


@pytest.mark.parametrize(
    ("fault", "answer"),
    [
        ({"kind": "drop"}, b"\x01\x03"),
        ({"kind": "timeout"}, b"\x01\x03"),
        ({"kind": "duplicate"}, b"\x01\x02\x02\x03"),
        ({"kind": "bad_crc"}, b"\x01\x57\x03"),
        ({"kind": "slow", "seconds": 0.05}, b"\x01\x02\x03"),
    ],
)
def test_faults_of_the_wire_strike_their_item_and_are_counted(plug, fault, answer):
    port, schedule = plug({**fault, "at": 1})
    assert ask(port.node().path, b"\x00\x01\x02", len(answer)) == answer
    assert schedule.injected == {fault["kind"]: 1}


def test_garbage_comes_before_the_item(plug):
    port, _ = plug({"kind": "garbage", "at": 1, "amount": 7})
    answer = ask(port.node().path, b"\x00\x01", 9)
    assert len(answer) == 9
    assert (answer[0], answer[-1]) == (1, 2)


def test_silence_lasts_as_long_as_it_says(plug):
    port, _ = plug({"kind": "timeout", "at": 0, "seconds": 0.4})
    assert ask(port.node().path, b"\x00", 1) == b""
    time.sleep(0.2)
    assert ask(port.node().path, b"\x00", 1) == b"\x01"


def test_a_pulled_port_fails_and_comes_back(plug):
    port, schedule = plug({"kind": "disconnect", "at": 1, "seconds": 0.1})
    with serial.Serial(port.node().path, timeout=0.5) as opened:
        opened.write(b"\x00")
        assert opened.read(1) == b"\x01"
        opened.write(b"\x00")
        with pytest.raises(OSError):  # noqa: PT011 - its words differ from system to system
            opened.read(1)
    assert schedule.injected == {"disconnect": 1}
    assert port.node() is None
    deadline_s = time.monotonic() + 30
    while port.node() is None and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert ask(port.node().path, b"\x05", 1) == b"\x06"


def test_pulled_from_another_thread_while_a_driver_waits(plug):
    port, _ = plug()
    with serial.Serial(port.node().path, timeout=2.0) as opened:
        port.unplug()
        with pytest.raises(OSError):  # noqa: PT011 - its words differ from system to system
            opened.read(1)
    assert port.node() is None
    port.plug()
    assert ask(port.node().path, b"\x05", 1) == b"\x06"
