"""Acquisition: from devices to a run file, by processes that survive each other.

One process per device, one ring of shared memory per camera, one writer, one recorder that outlives its
clients. `record` makes a run and waits for it; `start` and `running` give a `Session` to follow or stop.
"""

from thermacq.acquisition.api import Session, record, running, start
from thermacq.acquisition.job import RecordingResult
from thermacq.acquisition.messages import EndReason

__all__ = ["EndReason", "RecordingResult", "Session", "record", "running", "start"]
