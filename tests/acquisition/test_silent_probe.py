"""A probe that falls silent near the end of a run is too young for a time-out, but not overlooked."""

from pathlib import Path

from thermacq.acquisition import record
from thermacq.rig import parse_rig
from thermacq.store import open_run

RIG = """
clock = { kind = "virtual" }
[cameras.left]
driver = "test-pattern"
settings = { rows = 16, columns = 64 }
[cameras.right]
driver = "test-pattern"
settings = { rows = 16, columns = 64 }
[probes.gauge]
driver = "sim-probe"
settings = { silent_from_s = 0.3 }
"""


def test_a_probe_that_falls_silent_is_told(tmp_path: Path) -> None:
    result = record(parse_rig(RIG), tmp_path / "run.h5", frames=100)
    assert any("'gauge' fell silent" in warning for warning in result.warnings)
    with open_run(result.path) as run:
        assert 0 < run.probe("gauge").ticks.size < 100
        assert [event.kind for event in run.events() if event.device == "gauge"] == ["timeout"]
        assert run.frame_count("left") == 100
