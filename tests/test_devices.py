"""The records of the device interface: defaults, immutability, what they must not import."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from thermacq.devices import (
    Camera,
    CameraCapabilities,
    Frame,
    FrameFlag,
    SampleBlock,
    TriggerMode,
    TriggerSource,
    WaveProbe,
)


def test_a_block_without_pulses_has_an_empty_integer_array():
    block = SampleBlock(np.zeros((3, 1)), np.arange(3), 0, 0)
    assert block.pulse_ticks.shape == (0,)
    assert block.pulse_ticks.dtype == np.int64


def test_records_are_frozen():
    capabilities = CameraCapabilities(2, 3, 14, 60.0, frozenset({TriggerMode.FREE_RUN}))
    frame = Frame(np.zeros((2, 3), np.uint16), counter=-1, ticks=-1, host_ns=0)
    assert frame.flags is FrameFlag.NONE
    assert np.isnan(frame.fpa_temperature_k)
    for record, name in ((capabilities, "rows"), (frame, "counter")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(record, name, 1)


def test_flags_combine():
    both = FrameFlag.SHUTTER | FrameFlag.INCOMPLETE
    assert int(both) == 3
    assert FrameFlag.SHUTTER in both


def test_protocols_tell_devices_apart():
    class Silent:
        capabilities = None

        def open(self): ...
        def configure(self, settings): ...
        def arm(self): ...
        def samples(self, host): ...
        def disarm(self): ...
        def close(self): ...

    assert isinstance(Silent(), WaveProbe)
    assert not isinstance(Silent(), Camera)
    assert not isinstance(Silent(), TriggerSource)


def test_the_interface_does_not_import_numpy():
    code = "import sys, thermacq.devices, thermacq.plugins; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
