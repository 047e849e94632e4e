"""Whole recordings: real processes, real files, and every process of them killed once."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from thermacq.acquisition import EndReason, Session, record, running, start
from thermacq.acquisition.control import Status
from thermacq.errors import AcquisitionError
from thermacq.store import RunFile, open_run
from thermacq_drivers.testpattern import check_pattern

FREE_RUN = {"mode": "free_run", "frame_rate_hz": 100}
VIRTUAL = {"kind": "virtual"}


def kinds(run: RunFile) -> set[tuple[str, str]]:
    return {(event.device, str(event.kind)) for event in run.events()}


def when(session: Session, condition: Callable[[Status], bool], limit_s: float = 30.0) -> Status:
    """Wait until the status fulfils a condition."""
    deadline_s = time.monotonic() + limit_s
    while time.monotonic() < deadline_s:
        status = session.status()
        if status is not None and condition(status):
            return status
        time.sleep(0.02)
    raise AssertionError("it did not come to that")


def written(count: int) -> Callable[[Status], bool]:
    return lambda status: all(
        device["written"] >= count for device in status["devices"].values() if "written" in device
    )


@pytest.mark.slow
def test_software_triggers_record_complete_pairs(make_rig, tmp_path: Path) -> None:
    seen: list[Status] = []
    rig = make_rig()
    result = record(rig, tmp_path / "run.h5", frames=30, on_status=seen.append)
    assert result.asked_for
    assert result.end_reason == EndReason.COMPLETED
    states = [status["state"] for status in seen]
    assert states == sorted(states, key=["starting", "recording", "finishing", "ended"].index)
    with open_run(result.path) as run:
        assert run.complete
        assert run.rig == rig
        assert run.header.simulated
        assert run.cameras == ("left", "right")
        lost = result.summary["sync"]["devices"]
        for camera in run.cameras:
            frames = run.frames(camera)
            # A busy machine may fire late; each trigger is then either a frame or a recorded loss.
            assert len(frames) + lost[camera]["lost"].get("late_trigger", 0) == 30
            assert len(frames) == lost[camera]["received"] == lost[camera]["written"]
            assert [check_pattern(run.counts(camera, i)) for i in range(len(frames))] == list(
                range(len(frames))
            )
            deadlines = run.header.host_anchor_ns + frames.trigger_index * 20_000_000
            assert np.all(frames.trigger_ns >= deadlines)
            assert np.all(frames.trigger_ns <= deadlines + 1_000_000)
            assert np.all(frames.host_ns >= frames.trigger_ns)
        assert run.summary() == result.summary
        assert result.summary["sync"]["paired_by"] == "trigger index"
        left, right = (run.frames(camera).trigger_index for camera in run.cameras)
        assert result.summary["sync"]["pairs"] == np.intersect1d(left, right).size
        # The wall clock belongs to the start of the recording.
        assert abs(run.header.wall_anchor_ns - time.time_ns()) < 60e9


@pytest.mark.slow
def test_virtual_time_gives_the_same_run_twice(make_rig, tmp_path: Path) -> None:
    rig = make_rig(
        clock=VIRTUAL, probes={"wp": {"driver": "sim-probe"}}, store={"ring_s": 0.5, "reserve_mb": 1}
    )
    runs = []
    for name in ("one.h5", "two.h5"):
        result = record(rig, tmp_path / name, duration_s=2.0)
        assert result.end_reason == EndReason.COMPLETED
        assert result.summary["sync"]["note"] == "virtual clock: skew is simulated"
        with open_run(result.path) as run:
            frames = [run.frames(camera) for camera in run.cameras]
            probe = run.probe("wp")
            runs.append(
                [np.stack([f.counter, f.trigger_index, f.trigger_ns, f.host_ns, f.crc32]) for f in frames]
                + [probe.values, probe.ticks, probe.index, probe.host_ns]
            )
            assert all(len(f) == 100 for f in frames)
            assert len(probe) == 400
            assert run.events() == []
    assert all(np.array_equal(a, b) for a, b in zip(*runs, strict=True))
    assert running() == []


@pytest.mark.slow
def test_a_trigger_source_leads_and_its_pulses_date_the_frames(make_rig, tmp_path: Path) -> None:
    cached = {"rows": 48, "columns": 64, "cached_loop_frames": 2}
    rig = make_rig().model_dump() | {
        "clock": VIRTUAL,
        "trigger": {"mode": "hardware", "source": "box", "frame_rate_hz": 40},
        "trigger_sources": {"box": {"driver": "sim-trigger", "settings": {"jitter_s": 1e-4}}},
        "cameras": {
            "left": {"driver": "sim-camera", "settings": cached | {"side": "left", "loss_probability": 0.1}},
            "right": {"driver": "sim-camera", "settings": cached | {"side": "right"}},
        },
        "probes": {
            "wp": {
                "driver": "sim-probe",
                "settings": {"line": "trigger", "clock": {"offset_s": 7, "drift_ppm": 60}},
            }
        },
    }
    result = record(type(make_rig()).model_validate(rig), tmp_path / "run.h5", duration_s=3.0)
    sync = result.summary["sync"]
    assert result.end_reason == EndReason.COMPLETED
    assert result.summary["pulses"] == sync["devices"]["box"]["received"] == 120
    assert sync["devices"]["right"]["written"] == 120
    with open_run(result.path) as run:
        left, right = run.frames("left"), run.frames("right")
        assert 90 < len(left) < 120
        assert np.all(right.trigger_ns >= 0)
        np.testing.assert_array_equal(left.trigger_ns, right.trigger_ns[left.trigger_index])
        lost_inside = np.diff(left.trigger_index).sum() - (len(left) - 1) + left.trigger_index[0]
        assert sync["devices"]["left"]["lost"]["device_gap"] >= lost_inside - left.trigger_index[0]
        assert ("left", "device_gap") in kinds(run)
    clock = sync["clocks"]["wp"]
    assert clock["method"] == "pulses"
    assert clock["drift_ppm"] == pytest.approx(60, abs=1)


@pytest.mark.slow
def test_free_run_is_paired_by_device_time_and_its_gaps_are_counted(make_rig, tmp_path: Path) -> None:
    rig = make_rig({"lose_every": 10}, {"overrun_at_frame": 20, "incomplete_at_frame": 40}, trigger=FREE_RUN)
    result = record(rig, tmp_path / "run.h5", frames=80)
    sync = result.summary["sync"]
    assert sync["paired_by"] == "device time"
    assert sync["devices"]["left"]["lost"] == {"device_gap": 8}
    assert sync["devices"]["right"]["lost"] == {"overrun": 1, "incomplete": 1}
    with open_run(result.path) as run:
        for camera, missing in (("left", {9, 19, 29, 39, 49, 59, 69, 79}), ("right", {20, 40})):
            numbers = [check_pattern(run.counts(camera, i)) for i in range(80)]
            assert set(range(max(numbers))) - set(numbers) == missing
            assert np.array_equal(run.frames(camera).sequence_number - 65_400, numbers)
        assert kinds(run) >= {("left", "device_gap"), ("right", "overrun"), ("right", "incomplete")}


@pytest.mark.slow
def test_when_a_camera_dies_the_other_goes_on_and_all_is_kept(make_rig, tmp_path: Path) -> None:
    rig = make_rig({"fail_at_frame": 10}, reconnect={"policy": "fail"})
    result = record(rig, tmp_path / "run.h5", frames=100)
    assert result.end_reason == EndReason.CAMERA_LOST
    assert not result.asked_for
    assert "the camera is gone" in result.message
    with open_run(result.path) as run:
        assert run.complete
        assert len(run.frames("left")) <= 10
        assert run.frames("right").trigger_index[-1] > 30
        assert ("left", "disconnected") in kinds(run)


@pytest.mark.slow
def test_a_lost_camera_ends_an_endless_run(make_rig, tmp_path: Path) -> None:
    rig = make_rig({"fail_at_frame": 5}, {"fail_at_frame": 15}, reconnect={"policy": "fail"})
    result = record(rig, tmp_path / "run.h5")
    assert result.end_reason == EndReason.CAMERA_LOST


@pytest.mark.slow
@pytest.mark.parametrize("by_signal", [False, True])
def test_a_stop_keeps_everything(make_rig, tmp_path: Path, by_signal: bool) -> None:
    session = start(make_rig(), tmp_path / "run.h5")
    status = when(session, written(5))
    if by_signal:
        os.kill(status["pid"], signal.SIGTERM)
    else:
        session.stop()
    result = session.result()
    assert result.asked_for
    assert result.end_reason == EndReason.STOPPED
    with open_run(result.path) as run:
        assert run.complete
        assert run.frame_count("left") >= 5
        assert run.frame_count("left") == result.summary["sync"]["devices"]["left"]["received"]
        assert ("recorder", "stopped") in kinds(run)


@pytest.mark.slow
def test_a_stop_while_waiting_for_a_trigger(make_rig, tmp_path: Path) -> None:
    slow = {"mode": "software", "frame_rate_hz": 0.01}
    session = start(make_rig(trigger=slow), tmp_path / "run.h5", frames=5)
    when(session, lambda status: status["devices"].get("right", {}).get("received") == 1)
    began = time.monotonic()
    session.stop()
    assert session.result().end_reason == EndReason.STOPPED
    assert time.monotonic() - began < 20


@pytest.mark.slow
def test_two_recordings_at_once(make_rig, tmp_path: Path) -> None:
    sessions = [start(make_rig(), tmp_path / f"{number}.h5") for number in range(2)]
    for session in sessions:
        when(session, written(1))
    assert len(running()) == 2
    for session in sessions:
        session.stop()
    assert {session.result().path.name for session in sessions} == {"0.h5", "1.h5"}


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["left", "writer"])
def test_a_killed_child_ends_the_run_in_order(make_rig, tmp_path: Path, victim: str) -> None:
    rig = make_rig()
    session = start(rig, tmp_path / "run.h5", duration_s=120 if victim == "writer" else 8)
    status = when(session, written(10))
    os.kill(status["writer_pid"] if victim == "writer" else status["devices"][victim]["pid"], signal.SIGKILL)
    if victim == "writer":
        with pytest.raises(AcquisitionError, match="killed by SIGKILL") as caught:
            session.result()
        assert "thermacq recover" in caught.value.remedy
    else:
        result = session.result()
        assert result.end_reason == EndReason.CAMERA_LOST
        assert "SIGKILL" in result.message
    with open_run(tmp_path / "run.h5") as run:
        assert run.frame_count("left") >= 10
        assert run.frame_count("right") >= 10
        for camera in run.cameras:
            numbers = [check_pattern(run.counts(camera, i)) for i in range(run.frame_count(camera))]
            assert numbers == list(range(len(numbers)))
        assert run.complete == (victim != "writer")
        if victim == "left":
            assert ("left", "disconnected") in kinds(run)
            assert run.frame_count("right") > run.frame_count("left")


@pytest.mark.slow
def test_when_the_recorder_is_killed_the_writer_closes_the_file(make_rig, tmp_path: Path) -> None:
    session = start(make_rig(), tmp_path / "run.h5")
    status = when(session, written(10))
    os.kill(status["pid"], signal.SIGKILL)
    with pytest.raises(AcquisitionError, match="recorder process was lost"):
        session.result()
    deadline_s = time.monotonic() + 20
    while time.monotonic() < deadline_s:
        with open_run(tmp_path / "run.h5") as run:
            if run.complete:
                break
        time.sleep(0.1)
    with open_run(tmp_path / "run.h5") as run:
        assert run.complete
        assert run.frame_count("left") >= 10
        summary = run.summary()
        assert summary is not None
        assert summary["end_reason"] == EndReason.RECORDER_LOST


@pytest.mark.slow
def test_memory_processes_and_names_do_not_outlive_a_recording(make_rig, tmp_path: Path) -> None:
    before = set(Path("/dev/shm").iterdir())
    session = start(make_rig(), tmp_path / "run.h5")
    status = when(session, written(3))
    named = [name for name in set(Path("/dev/shm").iterdir()) - before if "thermacq" in name.name]
    assert named == []
    session.stop()
    session.result()
    pids = [status["pid"], status["writer_pid"], *(d["pid"] for d in status["devices"].values())]
    deadline_s = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in pids) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert not session.folder.exists()


@pytest.mark.slow
@pytest.mark.usefixtures("bad_drivers")
def test_probes_that_misbehave_are_told_and_harm_nobody(make_rig, tmp_path: Path) -> None:
    bad = ("Silent", "Garbage", "Crashing", "Deaf")
    rig = make_rig(probes={name.lower(): {"driver": name} for name in bad})
    result = record(rig, tmp_path / "run.h5", frames=40)
    assert result.end_reason == EndReason.COMPLETED
    warnings = "; ".join(result.warnings)
    assert "probe 'silent' delivered no sample" in warnings
    assert "device 'crashing' (acquire): its process ended with status 7" in warnings
    assert "device 'deaf' did not stop when told and was killed" in warnings
    devices = result.summary["sync"]["devices"]
    assert devices["garbage"]["lost"]["incomplete"] >= 3
    with open_run(result.path) as run:
        assert np.all(np.isfinite(run.probe("garbage").values))
        assert len(run.probe("garbage")) == devices["garbage"]["received"] > 0
        assert "garbage" in next(event.detail for event in run.events() if event.device == "garbage")
        expected = {("silent", "timeout"), ("deaf", "timeout"), ("crashing", "disconnected")}
        assert kinds(run) >= expected
        for camera in run.cameras:
            assert run.frame_count(camera) + devices[camera]["lost"].get("late_trigger", 0) == 40


@pytest.mark.slow
@pytest.mark.usefixtures("bad_drivers")
def test_a_driver_that_fails_to_open_is_named(make_rig, tmp_path: Path) -> None:
    with pytest.raises(AcquisitionError, match=r"'wp' \(open\): KeyError: 'no such port'"):
        record(make_rig(probes={"wp": {"driver": "FailingOpen"}}), tmp_path / "run.h5", frames=5)
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("bad_drivers")
def test_a_stop_while_a_device_hangs_in_open(make_rig, tmp_path: Path) -> None:
    session = start(make_rig(probes={"wp": {"driver": "HangingOpen"}}), tmp_path / "run.h5", frames=5)
    when(session, lambda status: status["devices"].get("left", {}).get("state") == "open")
    session.stop()
    with pytest.raises(AcquisitionError, match="stopped before the recording began"):
        session.result()
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.slow
def test_an_interrupt_ends_the_recording_and_is_raised_again(make_rig, tmp_path: Path) -> None:
    def interrupt(status: Status) -> None:
        if status["devices"] and written(5)(status):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(make_rig(), tmp_path / "run.h5", on_status=interrupt)
    with open_run(tmp_path / "run.h5") as run:
        assert run.complete


def test_a_run_file_is_never_overwritten(make_rig, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_text("precious")
    with pytest.raises(AcquisitionError, match="exists already"):
        record(make_rig(), path, frames=5)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("length", [{"duration_s": 0.0}, {"frames": 0}, {"duration_s": 1.0, "frames": 1}])
def test_an_impossible_length_is_refused(make_rig, tmp_path: Path, length: dict) -> None:
    with pytest.raises(AcquisitionError):
        start(make_rig(), tmp_path / "run.h5", **length)
