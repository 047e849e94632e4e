"""Errors say what, kept, remedy, and cross process borders whole."""

from __future__ import annotations

import pickle

import pytest

from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout, IncompleteFrame, StoreError


def test_an_error_reads_as_what_kept_remedy():
    error = StoreError("the disk is full", kept="412 frames are safe", remedy="free some space")
    assert str(error) == "the disk is full\n412 frames are safe\nfree some space"


def test_a_fault_names_device_stage_and_last_frame():
    fault = DeviceTimeout("left", "acquire", "no frame within 2 s", last_frame=41)
    assert fault.what == "device 'left' (acquire after frame 41): no frame within 2 s"
    assert DeviceTimeout("left", "open", "no answer").what == "device 'left' (open): no answer"


@pytest.mark.parametrize("kind", [DeviceFault, DeviceDisconnected, DeviceTimeout, IncompleteFrame])
def test_faults_survive_pickling(kind):
    fault = kind("left", "acquire", "gone", last_frame=3, kept="all", remedy="plug it in")
    twin = pickle.loads(pickle.dumps(fault))
    assert type(twin) is kind
    assert vars(twin) == vars(fault)


def test_plain_errors_survive_pickling():
    error = StoreError("what", kept="kept", remedy="remedy")
    twin = pickle.loads(pickle.dumps(error))
    assert (twin.what, twin.kept, twin.remedy) == ("what", "kept", "remedy")
