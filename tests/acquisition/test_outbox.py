import multiprocessing
import time

from thermacq.acquisition import outbox as module
from thermacq.acquisition.outbox import Outbox


def test_a_full_pipe_never_blocks_a_post(monkeypatch) -> None:
    monkeypatch.setattr(module, "_LONGEST", 500)
    reader, writer = multiprocessing.Pipe(duplex=False)
    outbox = Outbox(writer)
    message = "x" * 1000
    for number in range(700):
        outbox.post((number, message))
    # A pipe holds 64 KiB; some 60 messages are in it, 500 wait, the rest were thrown away and counted.
    assert 0 < outbox.thrown_away < 200
    received = []
    while reader.poll(0):
        received.append(reader.recv()[0])
        outbox.send(0)
    assert received == list(range(700 - outbox.thrown_away))
    outbox.close(0)
    reader.close()


def test_a_dead_reader_is_no_error() -> None:
    reader, writer = multiprocessing.Pipe(duplex=False)
    reader.close()
    outbox = Outbox(writer)
    outbox.post("lost")
    outbox.post_patiently("lost", lambda: False)
    outbox.close(0)


def test_a_patient_producer_still_stops_when_told() -> None:
    reader, writer = multiprocessing.Pipe(duplex=False)
    outbox = Outbox(writer)
    began = time.monotonic()
    for _ in range(200):
        outbox.post_patiently("x" * 1000, lambda: time.monotonic() - began > 0.2)
    assert reader.poll(0)
    outbox.close(0)
    reader.close()
