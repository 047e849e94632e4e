"""The Modbus level probe: registers to metres, and the driver, through pymodbus, on its emulated probe."""

from __future__ import annotations

import logging
import math
import struct
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import DeviceContext
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.testing.bench import StopSwitch
from thermacq.testing.emulators.modbus_level import ModbusProbe, ModbusProbeEmulation, attach, crc16
from thermacq.timing.clock import RealClock, VirtualClock
from thermacq_drivers.modbus_level import ModbusLevelProbe, decode_registers

SCALE = 0.003384 * 0.0254


@pytest.fixture(autouse=True)
def _quiet_library():
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


@contextmanager
def probe(tmp_path, settings=None, **emulation):
    clock = RealClock()
    with attach(Emulation("level", clock, tmp_path, emulation)) as transports:
        device = ModbusLevelProbe(DeviceContext("level", clock, transports=transports))
        try:
            device.open()
            device.configure({"rate_hz": 50, **(settings or {})})
            device.arm()
            yield device
        finally:
            device.close()


def take(device, samples):
    stream = device.samples(StopSwitch())
    return [next(stream) for _ in range(samples)]


def test_worked_bytes(tmp_path):
    assert crc16(bytes.fromhex("01 03 02 08 00 01")) == bytes.fromhex("04 70")
    settings = ModbusProbeEmulation(mean_counts=5000, amplitude_counts=0)
    emulated = ModbusProbe(Emulation("level", VirtualClock(), tmp_path), settings)
    request = bytes.fromhex("01 03 02 08 00 01 04 70")
    assert emulated.receive(request) == [bytes.fromhex("01 03 02 13 88 B5 12")]


@given(st.binary(max_size=60))
def test_no_bytes_break_the_emulated_probe(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp()
    emulated = ModbusProbe(Emulation("level", VirtualClock(), folder), ModbusProbeEmulation())
    for answer in emulated.receive(data):
        assert crc16(answer[:-2]) == answer[-2:]


@given(st.floats(width=32, allow_nan=False))
def test_floats_in_either_order_of_words(value):
    high, low = struct.unpack(">2H", struct.pack(">f", value))
    assert decode_registers([high, low], "float32") == value
    assert decode_registers([low, high], "float32_swapped") == value


def test_whole_numbers():
    assert decode_registers([0xFFFF], "uint16") == 65535
    assert decode_registers([0xFFFF], "int16") == -1
    assert decode_registers([1, 2], "uint32") == 65538
    assert decode_registers([1, 2], "uint32_swapped") == 131073
    assert math.isnan(decode_registers([1, 2], "uint16"))


def test_distances_arrive_in_metres(tmp_path):
    with probe(tmp_path, mean_counts=5000, amplitude_counts=0) as device:
        blocks = take(device, 10)
    np.testing.assert_allclose([block.values[0, 0] for block in blocks], 5000 * SCALE)
    assert [block.first_index for block in blocks] == list(range(10))
    assert device.capabilities.unit == "m"


@pytest.mark.parametrize("kind", ["bad_crc", "short_read", "drop"])
def test_a_damaged_answer_is_one_lost_sample_at_least(tmp_path, kind):
    # Answer 0 is the one to `configure`; waiting for one that does not come costs further questions.
    with probe(tmp_path, faults=[{"kind": kind, "at": 5}], amplitude_counts=0) as device:
        blocks = take(device, 12)
    steps = np.diff([block.first_index for block in blocks])
    assert steps.max() > 1
    assert (steps > 1).sum() == 1
    assert len({float(block.values[0, 0]) for block in blocks}) == 1


def test_silence_and_unplugging_are_typed(tmp_path):
    silent = {"faults": [{"kind": "timeout", "at": 3, "seconds": 60}]}
    with (
        probe(tmp_path, {"timeout_s": 0.5}, **silent) as device,
        pytest.raises(DeviceTimeout, match="no good answer"),
    ):
        take(device, 100)
    gone = {"faults": [{"kind": "disconnect", "at": 3}]}
    with probe(tmp_path, **gone) as device, pytest.raises(DeviceDisconnected, match="is gone"):
        take(device, 100)


def test_a_wrong_address_is_told_before_recording(tmp_path):
    with (
        pytest.raises(DeviceTimeout, match="slave 7 gives no register 0x0208"),
        probe(tmp_path, {"slave": 7}),
    ):
        pass
    wrong = {"register_address": 5}
    with pytest.raises(DeviceTimeout, match="slave 1 gives no register 0x0005"), probe(tmp_path, wrong):
        pass
    with pytest.raises(DeviceFault, match="did you mean 'encoding'"), probe(tmp_path, {"encodin": "int16"}):
        pass
