import time

from thermacq.timing import ClockSettings, make_clock


def test_virtual_time_starts_at_zero_and_moves_only_by_waiting() -> None:
    clock = make_clock(ClockSettings("virtual"))
    assert clock.now_ns() == 0
    assert clock.wait_until_ns(10**12) == 10**12
    assert clock.wait_until_ns(5) == 10**12
    clock.start()
    assert clock.now_ns() == 0


def test_paced_virtual_time_takes_real_time() -> None:
    clock = make_clock(ClockSettings("virtual", speed=100.0))
    clock.start()
    before = time.perf_counter_ns()
    clock.wait_until_ns(10**9)
    assert time.perf_counter_ns() - before >= 10_000_000 - 1000


def test_real_time_is_monotonic_time_and_reaches_deadlines() -> None:
    clock = make_clock(ClockSettings())
    before = time.perf_counter_ns()
    assert clock.wait_until_ns(before + 5_000_000) >= before + 5_000_000
    assert before <= clock.now_ns() <= time.perf_counter_ns()


def test_waiting_ends_when_asked() -> None:
    clock = make_clock(ClockSettings())
    now = clock.now_ns()
    assert clock.wait_until_ns(now + 3600 * 10**9, stopping=lambda: True) < now + 3600 * 10**9
