"""The run file: raw counts and every time stamp, written so that nothing committed is ever lost.

`RunWriter` writes it, `open_run` reads it, `recover` mends it, `verify` checks it, and the importer makes one of
pictures and videos that were taken elsewhere.
"""

from thermacq.store.codec import Compression, encode_frame, frame_crc32
from thermacq.store.disk import check_room
from thermacq.store.reader import RunFile, open_run
from thermacq.store.records import (
    CameraStream,
    Event,
    EventKind,
    FrameRow,
    FrameTable,
    ProbeSamples,
    ProbeStream,
    RunHeader,
)
from thermacq.store.recovery import RecoveryReport, recover
from thermacq.store.triggers import frame_times, trigger_line
from thermacq.store.verification import Finding, VerifyReport, verify
from thermacq.store.writer import RunWriter

__all__ = [
    "CameraStream",
    "Compression",
    "Event",
    "EventKind",
    "Finding",
    "FrameRow",
    "FrameTable",
    "ProbeSamples",
    "ProbeStream",
    "RecoveryReport",
    "RunFile",
    "RunHeader",
    "RunWriter",
    "VerifyReport",
    "check_room",
    "encode_frame",
    "frame_crc32",
    "frame_times",
    "open_run",
    "recover",
    "trigger_line",
    "verify",
]
