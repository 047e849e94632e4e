from __future__ import annotations

import threading
import time
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from thermacq.devices import Camera, DeviceContext, Frame, FrameFlag, TriggerMode
from thermacq.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceOverrun,
    DeviceTimeout,
    IncompleteFrame,
)
from thermacq.timing import RealClock, VirtualClock
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.simflume.camera import SimulatedCamera
from thermacq_drivers.simflume.ready_made import scene_toml

MakeContext = Callable[..., DeviceContext]
RATE_HZ = 50.0
PERIOD_NS = 20_000_000


def triggered(context: DeviceContext, settings: dict[str, Any], host: Any, frames: int = 4) -> list[Frame]:
    """Frames of a software-triggered recording in virtual time, with copies of their counts."""
    camera = SimulatedCamera(context)
    camera.open()
    camera.configure(settings)
    camera.arm(TriggerMode.SOFTWARE, RATE_HZ)
    stream = camera.frames(host)
    taken = []
    for index in range(frames):
        context.clock.wait_until_ns(index * PERIOD_NS)
        camera.trigger(index)
        taken.append(next(stream))
    camera.disarm()
    camera.close()
    return taken


def ready(context: DeviceContext, settings: dict[str, Any], mode: TriggerMode) -> SimulatedCamera:
    camera = SimulatedCamera(context)
    camera.open()
    camera.configure(settings)
    camera.arm(mode, RATE_HZ)
    return camera


def test_it_is_a_camera_and_says_who_it_is(context: MakeContext) -> None:
    camera = SimulatedCamera(context("port"))
    assert isinstance(camera, Camera)
    assert camera.open().serial == "SIM-port"


def test_configure_returns_everything_in_force(context: MakeContext, small: dict[str, Any]) -> None:
    camera = SimulatedCamera(context())
    camera.open()
    applied = camera.configure({**small, "sensor": {"netd_k": 0.05}})
    assert applied["rows"] == 128
    assert applied["sensor"]["netd_k"] == 0.05
    assert applied["tilt_deg"] == 22.8
    assert camera.capabilities.columns == 160
    assert camera.capabilities.trigger_modes == frozenset(TriggerMode)


def test_frames_are_reproducible_bit_by_bit(
    context: MakeContext, small: dict[str, Any], wave: dict[str, Any], host: Any
) -> None:
    first, second = (triggered(context(scene=wave), small, host) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.counts, other.counts)
        assert (one.counter, one.ticks, one.trigger_index) == (
            other.counter,
            other.ticks,
            other.trigger_index,
        )
    assert (first[0].counts != first[1].counts).mean() > 0.5
    other_name = triggered(context("right", scene=wave), small, host)
    assert (first[0].counts != other_name[0].counts).mean() > 0.5
    other_seed = triggered(context(scene={**wave, "seed": 2}), small, host)
    assert (first[0].counts != other_seed[0].counts).mean() > 0.5


def test_a_frame_depends_on_its_trigger_not_on_those_before(
    context: MakeContext, small: dict[str, Any], wave: dict[str, Any], host: Any
) -> None:
    all_frames = triggered(context(scene=wave), small, host)
    camera = ready(context(scene=wave, clock=(clock := VirtualClock())), small, TriggerMode.SOFTWARE)
    clock.wait_until_ns(3 * PERIOD_NS)
    camera.trigger(3)
    np.testing.assert_array_equal(next(camera.frames(host)).counts, all_frames[3].counts)
    camera.close()


def test_ticks_come_from_a_clock_of_its_own(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    settings = {**small, "clock": {"offset_s": 7.0, "drift_ppm": 100.0, "tick_rate_hz": 1e8}}
    ticks = [frame.ticks for frame in triggered(context(), settings, host)]
    expected = [round((7.0 + 1.0001 * index * 0.02) * 1e8) for index in range(4)]
    assert ticks == expected


def test_the_counter_wraps(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    settings = {**small, "counter_bits": 8, "counter_start": 254}
    assert [frame.counter for frame in triggered(context(), settings, host)] == [254, 255, 0, 1]


def test_latency_and_jitter_delay_the_exposure(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    settings = {**small, "trigger_latency_s": 0.001, "trigger_jitter_s": 0.0002}
    late_us = [
        frame.ticks - index * 20_000 for index, frame in enumerate(triggered(context(), settings, host))
    ]
    assert min(late_us) >= 1000
    assert len(set(late_us)) == 4


def test_free_run_follows_its_own_clock(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    camera = ready(context(), {**small, "clock": {"drift_ppm": 50_000.0}}, TriggerMode.FREE_RUN)
    stream = camera.frames(host)
    frames = [next(stream) for _ in range(4)]
    # Its clock is 5 % fast: its periods are shorter for the host, and exact by its own ticks.
    assert [frame.ticks for frame in frames] == [0, 20_000, 40_000, 60_000]
    assert frames[3].host_ns == pytest.approx(60e6 / 1.05, abs=2)
    assert [frame.trigger_index for frame in frames] == [-1] * 4
    camera.close()


def test_hardware_triggers_come_from_the_line(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    made = context()
    camera = ready(made, {**small, "line": "strobe"}, TriggerMode.HARDWARE)
    source = LineWriter(made.runtime_dir, "strobe")
    source.start_session()
    for pulse_ns in (5_000_000, 25_100_000):
        source.emit(pulse_ns)
    stream = camera.frames(host)
    frames = [next(stream), next(stream)]
    assert [frame.trigger_index for frame in frames] == [0, 1]
    assert [frame.ticks for frame in frames] == [5000, 25100]
    assert source.lead() == 0
    source.finish_session()
    host.stop_after = 5
    assert next(stream, None) is None
    camera.close()


def test_waiting_for_a_trigger_ends_when_the_host_stops(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    for mode in (TriggerMode.SOFTWARE, TriggerMode.HARDWARE):
        camera = ready(context(clock=RealClock()), small, mode)
        threading.Timer(0.1, setattr, (host, "stop", True)).start()
        begun = time.monotonic()
        assert next(camera.frames(host), None) is None
        assert time.monotonic() - begun < 3
        camera.close()
        host.stop = False


@pytest.mark.parametrize("mode", [TriggerMode.SOFTWARE, TriggerMode.HARDWARE])
def test_no_trigger_is_a_timeout(
    context: MakeContext, small: dict[str, Any], host: Any, mode: TriggerMode
) -> None:
    camera = ready(context(), {**small, "timeout_s": 0.05}, mode)
    with pytest.raises(DeviceTimeout, match=r"within 0\.05 s"):
        next(camera.frames(host))
    camera.close()


def test_a_lost_frame_is_a_gap_of_the_counter(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    camera = ready(context(), {**small, "loss_probability": 0.5}, TriggerMode.FREE_RUN)
    stream = camera.frames(host)
    frames = [next(stream) for _ in range(6)]
    counters = [frame.counter for frame in frames]
    assert counters != list(range(6))
    assert [frame.ticks for frame in frames] == [counter * 20_000 for counter in counters]
    camera.close()


def test_a_lost_triggered_frame_is_reported(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    camera = ready(context(), {**small, "loss_probability": 0.999}, TriggerMode.SOFTWARE)
    camera.trigger(0)
    with pytest.raises(IncompleteFrame, match="frame 0 did not arrive"):
        next(camera.frames(host))
    camera.close()


@pytest.mark.parametrize(
    ("setting", "fault"),
    [
        ("fail_at_frame", DeviceDisconnected),
        ("stall_at_frame", DeviceTimeout),
        ("incomplete_at_frame", IncompleteFrame),
        ("overrun_at_frame", DeviceOverrun),
    ],
)
def test_ordered_faults(
    context: MakeContext, small: dict[str, Any], host: Any, setting: str, fault: type[DeviceFault]
) -> None:
    camera = ready(context(), {**small, setting: 2, "timeout_s": 0.05}, TriggerMode.FREE_RUN)
    stream = camera.frames(host)
    next(stream), next(stream)
    with pytest.raises(fault) as caught:
        next(stream)
    assert caught.value.last_frame == 1
    camera.disarm()
    camera.close()


def test_the_stream_goes_on_after_an_incomplete_frame(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    camera = ready(context(), {**small, "incomplete_at_frame": 1}, TriggerMode.FREE_RUN)
    stream = camera.frames(host)
    next(stream)
    with pytest.raises(IncompleteFrame):
        next(stream)
    assert next(camera.frames(host)).counter == 2
    camera.close()


def test_a_cached_loop_repeats(
    context: MakeContext, small: dict[str, Any], wave: dict[str, Any], host: Any
) -> None:
    frames = triggered(context(scene=wave), {**small, "cached_loop_frames": 3}, host)
    np.testing.assert_array_equal(frames[3].counts, frames[0].counts)
    drawn = triggered(context(scene=wave), small, host)
    np.testing.assert_array_equal(frames[2].counts, drawn[2].counts)


def test_a_slow_free_run_in_real_time_leaves_gaps(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    camera = ready(context(clock=RealClock()), {**small, "cached_loop_frames": 1}, TriggerMode.FREE_RUN)
    stream = camera.frames(host)
    next(stream)
    time.sleep(0.3)
    assert next(stream).counter >= 10
    camera.close()


def test_verbs_in_the_wrong_state(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    camera = SimulatedCamera(context())
    camera.disarm()
    camera.close()
    with pytest.raises(DeviceFault, match="not open"):
        camera.configure(small)
    with pytest.raises(DeviceFault, match="not open"):
        camera.arm(TriggerMode.SOFTWARE, RATE_HZ)
    camera.open()
    with pytest.raises(DeviceFault, match="not armed"):
        next(camera.frames(host))
    camera.configure(small)
    camera.arm(TriggerMode.FREE_RUN, RATE_HZ)
    with pytest.raises(DeviceFault, match="not armed for software"):
        camera.trigger(0)
    with pytest.raises(DeviceFault, match="at most 200"):
        camera.arm(TriggerMode.FREE_RUN, 500.0)
    camera.close()


def test_bad_settings_and_impossible_places(context: MakeContext, wave: dict[str, Any]) -> None:
    camera = SimulatedCamera(context(scene=wave))
    camera.open()
    with pytest.raises(DeviceFault, match="did you mean 'tilt_deg'"):
        camera.configure({"tilt": 20})
    with pytest.raises(DeviceFault, match="under water"):
        camera.configure({"height_m": 0.03})
    with pytest.raises(DeviceFault, match="tilt the camera less"):
        camera.configure({"tilt_deg": 75})
    with pytest.raises(DeviceFault, match="folds"):
        camera.configure({"distortion": [-5, 0, 0, 0, 0]})
    boards = SimulatedCamera(context(scene={"view": "chessboard", "chessboard": {"square_m": 0.3}}))
    boards.open()
    with pytest.raises(DeviceFault, match="does not fit"):
        boards.configure({})
    broken = SimulatedCamera(context(scene={"sead": 1}))
    broken.open()
    with pytest.raises(DeviceFault, match="unknown key 'sead'"):
        broken.configure({})


def test_while_the_shutter_is_closed_the_picture_is_frozen_and_flagged(
    context: MakeContext, small: dict[str, Any], wave: dict[str, Any], host: Any
) -> None:
    open_frames = triggered(context(scene=wave), small, host, 9)
    settings = {**small, "shutter": {"at_s": [0.05], "closed_s": 0.1}}
    frames = triggered(context(scene=wave), settings, host, 9)
    assert [bool(frame.flags & FrameFlag.SHUTTER) for frame in frames] == [False] * 3 + [True] * 5 + [False]
    for frame in frames[3:8]:
        np.testing.assert_array_equal(frame.counts, open_frames[2].counts)
    assert [frame.counter for frame in frames] == list(range(9))
    assert (frames[8].counts != frames[7].counts).mean() > 0.5
    # A camera that is armed within the event freezes the same picture.
    camera = ready(context(scene=wave, clock=(clock := VirtualClock())), settings, TriggerMode.SOFTWARE)
    assert camera.capabilities.has_shutter
    clock.wait_until_ns(5 * PERIOD_NS)
    camera.trigger(5)
    np.testing.assert_array_equal(next(camera.frames(host)).counts, open_frames[2].counts)
    camera.close()


def test_frames_carry_the_temperature_of_the_focal_plane(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    settings = {**small, "warm_up": {"powered_for_s": 600.0, "reading_noise_k": 0.0}}
    expected = 295 + 10 * (1 - np.exp(-(600.02) / 480))
    assert triggered(context(), settings, host, 2)[1].fpa_temperature_k == pytest.approx(expected, abs=1e-9)
    assert triggered(context(), small, host, 1)[0].fpa_temperature_k == pytest.approx(305.0, abs=0.03)


def test_the_scene_may_set_the_condition_of_the_cameras(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    scene = {
        "view": "uniform",
        "uniform": {"temperatures_k": [290.0, 700.0 / 2], "frames_per_temperature": 2},
        "camera": {
            "sensor": {"bit_depth": 16, "counts_per_k": 1000.0, "bad_pixel_fraction": 0.0},
            "bolometer": {"line_time_s": 3e-5},
        },
    }
    camera = SimulatedCamera(context(scene=scene))
    camera.open()
    applied = camera.configure({**small, "sensor": {"netd_k": 0.5}, "tilt_deg": 10.0})
    assert applied["sensor"]["bit_depth"] == 16
    assert applied["sensor"]["netd_k"] == 0.035
    assert applied["tilt_deg"] == 10.0
    assert camera.configure(applied) == applied
    assert camera.capabilities.bit_depth == 16
    assert camera.capabilities.line_time_s == 3e-5
    frames = triggered(context(scene=scene), small, host, 4)
    assert frames[1].counts.mean() == pytest.approx(24000 - 5000, abs=60)
    # 55 K above the reference is beyond full scale.
    assert (frames[2].counts == 2**16 - 1).all()
    np.testing.assert_array_equal(frames[2].counts, frames[3].counts)


def test_a_raw_camera_is_reproducible_whatever_came_before(
    context: MakeContext, small: dict[str, Any], wave: dict[str, Any], host: Any
) -> None:
    raw = tomllib.loads(scene_toml("cold-start"))["camera"]
    scene = {**wave, "camera": {**raw, "shutter": {"at_s": [0.03], "closed_s": 0.04}}}
    frames = triggered(context(scene=scene), small, host, 6)
    camera = ready(context(scene=scene, clock=(clock := VirtualClock())), small, TriggerMode.SOFTWARE)
    clock.wait_until_ns(5 * PERIOD_NS)
    camera.trigger(5)
    alone = next(camera.frames(host))
    np.testing.assert_array_equal(alone.counts, frames[5].counts)
    camera.close()


def test_a_cached_loop_keeps_the_flags(context: MakeContext, small: dict[str, Any], host: Any) -> None:
    settings = {**small, "cached_loop_frames": 3, "shutter": {"at_s": [0.015], "closed_s": 0.01}}
    flags = [frame.flags for frame in triggered(context(), settings, host, 6)]
    assert flags == [FrameFlag.NONE, FrameFlag.SHUTTER, FrameFlag.NONE] * 2


@pytest.mark.parametrize(
    "name",
    ["blackbody", "cold-start", "dirty-sensor", "real-cameras", "chessboard-moved", "chessboard-corner"],
)
def test_shipped_scenes_give_pictures_within_range(
    context: MakeContext, small: dict[str, Any], host: Any, name: str
) -> None:
    scene = tomllib.loads(scene_toml(name))
    frame = triggered(context(scene=scene), small, host, 2)[1]
    low, high = np.percentile(frame.counts, (1, 99))
    assert 2000 < low < high < 12000
    assert frame.counts.std() > 3
