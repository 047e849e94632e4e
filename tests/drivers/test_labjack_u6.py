"""The LabJack U6 driver on emulated devices with faults."""

from __future__ import annotations

import time
from contextlib import contextmanager

import numpy as np
import pytest

from thermacq.devices import DeviceContext
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Emulation
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.testing.emulators.labjack_u6 import attach
from thermacq.timing.clock import VirtualClock
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.labjack_u6 import codec
from thermacq_drivers.labjack_u6.link import discover
from thermacq_drivers.labjack_u6.probe import LabJackU6

FOUR = {
    "inputs": [{"name": f"gauge{ain}", "ain": ain} for ain in range(4)],
    "line": 2,
}


class Host:
    def stopping(self):
        return False


@contextmanager
def gauge(tmp_path, settings=None, clock=None, serial="", **emulation):
    clock = clock or VirtualClock()
    with attach(Emulation("gauge", clock, tmp_path, emulation)) as transports:
        device = LabJackU6(DeviceContext("gauge", clock, transports=transports, serial=serial))
        try:
            device.open()
            device.configure(settings or {})
            device.arm()
            yield device
        finally:
            device.close()


def take(device, scans):
    """Blocks up to this scan, and the faults through which the stream went on."""
    blocks, faults = [], []
    stream = device.samples(Host())
    while not blocks or blocks[-1].first_index + len(blocks[-1].ticks) < scans:
        try:
            blocks.append(next(stream))
        except (IncompleteFrame, DeviceOverrun) as fault:
            faults.append(type(fault))
            stream = device.samples(Host())
    return blocks, faults


def together(blocks):
    index = np.concatenate([block.first_index + np.arange(len(block.ticks)) for block in blocks])
    return index, np.concatenate([block.values for block in blocks])


def test_identity_and_what_is_really_applied(tmp_path):
    with gauge(tmp_path, {**FOUR, "rate_hz": 997.0}, serial="", pro=True) as device:
        identity = device.open()
        applied = device.configure({**FOUR, "rate_hz": 997.0})
        assert device.configure(applied) == applied
        assert device.capabilities.tick_rate_hz == 48e6
    assert (identity.model, identity.firmware, len(identity.serial)) == ("U6-Pro", "1.45", 9)
    assert applied["rate_hz"] == pytest.approx(48e6 / 48_144)
    assert applied["calibration"] == "device"


def test_volts_are_those_of_the_sine_through_the_devices_own_constants(tmp_path):
    inputs = [{"name": "a", "ain": 0}, {"name": "b", "ain": 4, "gain": 10, "differential": True}]
    with gauge(tmp_path, {"inputs": inputs}, amplitude_v=0.5, wave_hz=2.0) as device:
        blocks, faults = take(device, 1000)
    index, values = together(blocks)
    wave = 0.5 * np.sin(2 * np.pi * 2.0 * index / 1000)
    np.testing.assert_allclose(values[:, 0], wave, atol=1.7e-4)
    np.testing.assert_allclose(values[:, 1], wave + 0.4, atol=1.7e-5)
    assert not faults
    # Nominal constants are off by 0.2 % and 7.25 codes.
    with gauge(tmp_path, {"inputs": inputs, "calibration": "nominal"}, amplitude_v=0.5) as device:
        _, nominal = together(take(device, 1000)[0])
    assert nominal[0, 0] > 2e-3


def test_a_blank_memory_gives_nominal_constants_and_says_so(tmp_path, caplog):
    with gauge(tmp_path, blank_calibration=True) as device:
        assert device.configure({})["calibration"] == "nominal"
    assert "nominal calibration is used" in caplog.text


@pytest.mark.parametrize("rate_hz", [2.0, 40.0, 333.0, 5000.0])
def test_blocks_are_short_at_every_rate_and_scans_follow_each_other(tmp_path, rate_hz):
    with gauge(tmp_path, {**FOUR, "rate_hz": rate_hz}) as device:
        blocks, faults = take(device, 40)
        capabilities = device.capabilities
    index, _ = together(blocks)
    ticks = np.concatenate([block.ticks for block in blocks])
    np.testing.assert_array_equal(index, np.arange(index.size))
    assert not faults
    assert set(np.diff(ticks)) == {round(capabilities.tick_rate_hz / rate_hz)}
    assert max(np.ptp(block.ticks) for block in blocks) <= 0.25 * capabilities.tick_rate_hz


@pytest.mark.parametrize(
    ("fault", "lost_packets", "announced"),
    [
        ({"kind": "bad_crc", "at": 30, "items": 2}, 2, [IncompleteFrame, IncompleteFrame]),
        ({"kind": "short_read", "at": 30, "amount": 9}, 1, [IncompleteFrame]),
        ({"kind": "garbage", "at": 30, "amount": 17}, 0, [IncompleteFrame]),
        ({"kind": "drop", "at": 30, "items": 3}, 3, []),
        ({"kind": "duplicate", "at": 30}, 0, []),
        ({"kind": "stall", "at": 30}, 1, [IncompleteFrame]),
    ],
)
def test_every_fault_is_announced_and_its_gap_is_exact(tmp_path, fault, lost_packets, announced):
    with gauge(tmp_path, {**FOUR, "inputs": FOUR["inputs"][:3]}, faults=[fault]) as device:
        blocks, faults = take(device, 1000)
    index, values = together(blocks)
    # Packets of 25 samples, scans of 4: those that touch a lost packet are gone, no other.
    lost = set(range(30, 30 + lost_packets))
    whole = [scan for scan in range(index[-1] + 1) if not lost & {4 * scan // 25, (4 * scan + 3) // 25}]
    assert index.tolist() == whole
    assert faults == announced
    np.testing.assert_allclose(values[:, 0], np.sin(np.pi * index / 1000), atol=1.7e-4)


def test_a_late_host_costs_scans_that_are_counted_exactly(tmp_path):
    slow = {"kind": "slow", "at": 40, "seconds": 2.0}
    with gauge(tmp_path, FOUR, faults=[slow]) as device:
        blocks, faults = take(device, 4000)
    index, values = together(blocks)
    gaps = np.diff(index) - 1
    assert faults == [DeviceOverrun]
    # It keeps 984 samples (196 scans of 5) of the 2000 scans.
    assert 1750 < gaps.sum() < 2000
    assert np.count_nonzero(gaps) == 1
    np.testing.assert_allclose(values[:, 1], 0.1 + np.sin(np.pi * index / 1000), atol=1.7e-4)


def test_silence_and_unplugging_are_typed(tmp_path):
    silent = [{"kind": "timeout", "at": 20, "items": 100_000}]
    with (
        gauge(tmp_path, {"timeout_s": 0.3}, faults=silent) as device,
        pytest.raises(DeviceTimeout, match="no packet within"),
    ):
        take(device, 100_000)
    gone = [{"kind": "disconnect", "at": 20}]
    with gauge(tmp_path, faults=gone) as device, pytest.raises(DeviceDisconnected, match="gone from USB"):
        take(device, 100_000)


def test_it_works_again_after_it_was_plugged_in_again(tmp_path):
    with gauge(tmp_path, FOUR, faults=[{"kind": "disconnect", "at": 20, "seconds": 0.2}]) as device:
        with pytest.raises(DeviceDisconnected):
            take(device, 100_000)
        device.close()
        time.sleep(0.3)
        device.open()
        device.configure(FOUR)
        device.arm()
        blocks, _ = take(device, 500)
    assert blocks[0].first_index == 0


def test_a_stream_that_was_left_running_is_ended(tmp_path):
    with gauge(tmp_path, FOUR, left_running=True) as device:
        blocks, faults = take(device, 300)
        assert not faults
        # Started behind the driver's back: error 48 at StreamStart.
        device.arm()
        device._link.ask(codec.STREAM_START, "test")
        blocks, _ = take(device, 300)
    np.testing.assert_array_equal(together(blocks)[0], np.arange(len(together(blocks)[0])))


@pytest.mark.parametrize("clock_ppm", [0.0, 50.0])
def test_pulses_on_the_line_get_ticks(tmp_path, clock_ppm):
    clock = VirtualClock()
    with gauge(tmp_path, FOUR, clock, clock_ppm=clock_ppm, line="trigger", line_input=2) as device:
        line = LineWriter(tmp_path, "trigger")
        line.start_session()
        pulses_s = 0.0137 + np.arange(100) * 0.02
        for pulse_s in pulses_s:
            line.emit(clock.now_ns() + round(pulse_s * 1e9))
        line.finish_session()
        blocks, _ = take(device, 2500)
    ticks = np.concatenate([block.pulse_ticks for block in blocks])
    stamped_s = ticks / device.capabilities.tick_rate_hz
    assert ticks.size == 100
    np.testing.assert_allclose(stamped_s, pulses_s * (1 + clock_ppm * 1e-6), atol=0.51e-3)


def test_several_devices_are_told_apart_by_their_own_numbers(tmp_path):
    clock = VirtualClock()
    with (
        attach(Emulation("a", clock, tmp_path, {"serial": "360000001"})) as first,
        attach(Emulation("b", clock, tmp_path, {"serial": "360000002", "pro": True})) as second,
    ):
        both: EmulatedTransports = first + second
        assert [(one.serial, one.model) for one in discover(both)] == [
            ("360000001", "U6"),
            ("360000002", "U6-Pro"),
        ]
        wanted = LabJackU6(DeviceContext("b", clock, transports=both, serial="360000002"))
        assert wanted.open().serial == "360000002"
        # One that is in use is listed, without its number.
        assert [one.serial for one in discover(both)] == ["360000001", ""]
        wanted.close()
        with pytest.raises(DeviceFault, match="360000001, 360000002"):
            LabJackU6(DeviceContext("c", clock, transports=both)).open()
        with pytest.raises(DeviceDisconnected, match="no LabJack U6 with serial number '9'"):
            LabJackU6(DeviceContext("d", clock, transports=both, serial="9")).open()


def test_mistakes_in_the_settings_say_what_to_mend(tmp_path):
    with gauge(tmp_path) as device:
        for wrong, words in (
            ({"rate_hz": 20_000, **FOUR}, "at most 10000 scans/s with 5 channels"),
            ({"inputs": [{"name": "a", "ain": 1, "differential": True}]}, "even terminal"),
            ({"inputs": [{"name": "a", "ain": 1}, {"name": "a", "ain": 2}]}, "each name once"),
            ({"line": 16}, "line"),
        ):
            with pytest.raises(DeviceFault, match=words):
                device.configure(wrong)
        with pytest.raises(DeviceFault, match="not configured"):
            device.arm()
