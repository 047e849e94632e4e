"""The serial side of the Boson driver: each fault of the wire, late answers, and what the camera refuses."""

from __future__ import annotations

import pytest

from thermacq.devices import TriggerMode
from thermacq.errors import DeviceTimeout
from thermacq_drivers.boson.camera import BosonCamera

from .bench import take_frames as take
from .boson_bench import QUICK, camera, context, plugged


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Unanswered calls are given up sooner than a real camera's."""
    monkeypatch.setattr("thermacq_drivers.boson.control._ANSWER_S", 0.5)


SERIAL_FAULTS = [
    {"kind": "bad_crc", "at": 4},
    {"kind": "short_read", "at": 4},
    {"kind": "drop", "at": 4},
    {"kind": "duplicate", "at": 4, "items": 3},
    {"kind": "garbage", "at": 4, "amount": 64},
    {"kind": "slow", "at": 4, "seconds": 0.7},
]


@pytest.mark.parametrize("fault", SERIAL_FAULTS, ids=[fault["kind"] for fault in SERIAL_FAULTS])
def test_the_serial_side_goes_on_after_each_fault(tmp_path, fault):
    with camera(tmp_path, serial_faults=[fault]) as device:
        assert device.applied["telemetry"] == "16-bit"
        control = device._control
        noticed = control.damaged + control.unanswered + control.late_replies
        assert noticed >= (0 if fault["kind"] == "garbage" else 1)
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, _ = take(device, 3)
    assert len(frames) == 3


def test_a_late_reply_is_no_answer_to_the_next_question(tmp_path):
    late = {"kind": "slow", "at": 3, "seconds": 0.7}
    with plugged(tmp_path, serial_faults=[late]) as transports:
        device = BosonCamera(context(transports))
        device.open()
        device.configure(QUICK)
        assert device._control.unanswered == 1
        assert device._control.late_replies == 1
        device.close()


def test_a_camera_that_says_nothing_is_told(tmp_path):
    silent = {"kind": "timeout", "at": 0, "seconds": 60}
    with plugged(tmp_path, serial_faults=[silent]) as transports:
        device = BosonCamera(context(transports))
        with pytest.raises(DeviceTimeout, match="no answer to camera_serial"):
            device.open()


def test_modes_that_were_set_elsewhere_are_adopted(tmp_path):
    with camera(tmp_path, {"ffc_mode": "auto", "gain": "low", "timeout_s": 3.0}) as device:
        device._settings = device._settings.model_copy(update={"ffc_mode": "manual", "gain": "high"})
        adopted = device.adopt()
        assert (adopted["ffc_mode"], adopted["gain"]) == ("auto", "low")
        assert (adopted["telemetry"], adopted["timeout_s"]) == ("16-bit", 3.0)
        device.arm(TriggerMode.FREE_RUN, 60)
        assert len(take(device, 2)[0]) == 2
