from pathlib import Path

import pytest

from thermacq.acquisition import plan
from thermacq.acquisition.job import Job
from thermacq.acquisition.messages import Opened
from thermacq.devices import CameraCapabilities, DeviceIdentity, DeviceKind, ProbeCapabilities, TriggerMode
from thermacq.errors import AcquisitionError, RigError


def job(rig, **given) -> Job:
    return Job("id", rig, Path("/nowhere/run.h5"), **given)


def camera(serial: str, rows: int = 48, columns: int = 64) -> Opened:
    can = CameraCapabilities(rows, columns, 14, 100.0, frozenset({TriggerMode.SOFTWARE}), tick_rate_hz=1e6)
    return Opened(DeviceIdentity("test-pattern", "m", serial), {}, can)


@pytest.mark.parametrize(
    ("duration_s", "rate_hz", "count"), [(0.3, 10.0, 3), (1.0, 50.0, 50), (0.31, 10.0, 4), (1e-9, 50.0, 1)]
)
def test_the_last_trigger_comes_before_the_end(make_rig, duration_s, rate_hz, count) -> None:
    rig = make_rig(trigger={"frame_rate_hz": rate_hz})
    order = plan.arm_order(job(rig, duration_s=duration_s), DeviceKind.CAMERA)
    assert order.count == count
    assert order.end_ns is None
    assert (order.count - 1) / rate_hz < duration_s


def test_free_run_watches_the_time_and_probes_never_count_frames(make_rig) -> None:
    rig = make_rig(trigger={"mode": "free_run", "frame_rate_hz": 10})
    timed, counted = job(rig, duration_s=2.0), job(rig, frames=20)
    assert plan.arm_order(timed, DeviceKind.CAMERA).end_ns == 2_000_000_000
    assert plan.arm_order(timed, DeviceKind.CAMERA).count is None
    assert plan.arm_order(counted, DeviceKind.CAMERA).count == 20
    assert plan.arm_order(counted, DeviceKind.CAMERA).end_ns is None
    assert plan.arm_order(counted, DeviceKind.WAVE_PROBE).end_ns is None
    virtual = job(make_rig(trigger={"frame_rate_hz": 10}, clock={"kind": "virtual"}), frames=20)
    assert plan.arm_order(virtual, DeviceKind.WAVE_PROBE).end_ns == 2_000_000_000


def test_a_ring_holds_the_time_that_the_rig_says(make_rig) -> None:
    rig = make_rig(trigger={"frame_rate_hz": 50}, store={"ring_s": 1.5})
    assert plan.ring_slots(rig) == 75


def test_only_the_leading_trigger_source_takes_part(make_rig) -> None:
    sources = {name: {"driver": "sim-trigger"} for name in ("a", "b")}
    software = make_rig(trigger_sources=sources)
    assert [spec.name for spec in plan.device_specs(software, Path())] == ["left", "right"]
    hardware = make_rig(trigger_sources=sources, trigger={"mode": "hardware", "source": "b"})
    specs = plan.device_specs(hardware, Path())
    assert [spec.name for spec in specs] == ["left", "right", "b"]
    assert [spec.index for spec in specs] == [0, 1, 2]


def test_a_pinned_core_is_what_the_rig_says(make_rig) -> None:
    rig = make_rig(cameras={"one": {"driver": "test-pattern", "pin_to_core": 1}})
    assert [spec.core for spec in plan.device_specs(rig, Path())] == [1]


def test_devices_that_do_not_fit_are_refused_with_both_sizes(make_rig, tmp_path: Path) -> None:
    work = Job("id", make_rig(), tmp_path / "run.h5")
    plan.check_fit(work, {"left": camera("1"), "right": camera("2")})
    with pytest.raises(RigError, match="left 64 x 48, right 80 x 60"):
        plan.check_fit(work, {"left": camera("1"), "right": camera("2", 60, 80)})


def test_a_calibration_of_another_size_is_refused(make_rig, tmp_path: Path) -> None:
    work = Job("id", make_rig(), tmp_path / "run.h5", calibration={"image_size": [640, 512]})
    with pytest.raises(RigError, match="640 x 512 pixels, camera 'left' makes 64 x 48"):
        plan.check_fit(work, {"left": camera("1"), "right": camera("2")})


def test_a_calibration_of_other_cameras_is_refused(make_rig, tmp_path: Path) -> None:
    devices = {"left": camera("1"), "right": camera("2")}
    fits = {"image_size": [64, 48], "serials": ["1", "2"]}
    plan.check_fit(Job("id", make_rig(), tmp_path / "run.h5", calibration=fits), devices)
    exchanged = {"image_size": [64, 48], "serials": ["2", "1"]}
    with pytest.raises(RigError, match=r"for cameras \['2', '1'\], the rig has \['1', '2'\]"):
        plan.check_fit(Job("id", make_rig(), tmp_path / "run.h5", calibration=exchanged), devices)


def test_streams_carry_what_the_devices_said() -> None:
    probe = Opened(DeviceIdentity("p", "m", "9"), {"gain": 2}, ProbeCapabilities(("a",), "V", 100.0, 1e3))
    cameras, probes = plan.streams({"left": camera("1"), "wp": probe})
    assert (cameras[0].name, cameras[0].rows, cameras[0].columns) == ("left", 48, 64)
    assert cameras[0].capabilities["trigger_modes"] == ["software"]
    assert cameras[0].identity["serial"] == "1"
    assert (probes[0].channels, probes[0].unit, probes[0].tick_rate_hz) == (("a",), "V", 1e3)
    assert probes[0].applied == {"gain": 2}


def test_expected_size_is_that_of_the_uncompressed_pictures(make_rig) -> None:
    opened = {"left": camera("1"), "right": camera("2")}
    assert plan.expected_bytes(job(make_rig(), frames=10), opened) == 10 * 2 * 48 * 64 * 2
    rig = make_rig(trigger={"frame_rate_hz": 50})
    assert plan.expected_bytes(job(rig, duration_s=2.0), opened) == 100 * 2 * 48 * 64 * 2
    assert plan.expected_bytes(job(rig), opened) == 0


@pytest.mark.parametrize(
    "length",
    [{"duration_s": 0.0}, {"frames": 0}, {"duration_s": 1.0, "frames": 1}, {"duration_s": float("nan")}],
)
def test_an_impossible_length_is_refused(make_rig, length: dict) -> None:
    with pytest.raises(AcquisitionError):
        plan.check_time(job(make_rig(), **length))


def test_a_job_survives_its_journey(make_rig) -> None:
    work = job(make_rig(probes={"wp": {"driver": "sim-probe", "x_m": 0.5}}), duration_s=1.5)
    assert Job.from_dict(work.to_dict()) == work
