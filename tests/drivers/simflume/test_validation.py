from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from thermacq_drivers.simflume import validation
from thermacq_drivers.simflume.commands import app
from thermacq_drivers.simflume.validation import PAGE, PICTURES, TOPICS, page_text, run_checks, table_lines
from thermacq_drivers.simflume.validation_water import Check, failed

ROOT = Path(__file__).resolve().parents[3]
GOOD, BAD = Check("depth|a", "m", 0.9, 0.901, 0.002), Check("depth", "m", 0.9, 0.8, 0.002)


def test_topics_that_take_no_time_hold() -> None:
    told: list[str] = []
    found = run_checks(["heights", "response"], told.append)
    assert told == list(found) == ["heights", "response"]
    assert failed([check for checks in found.values() for check in checks]) == []


def test_a_table_says_what_holds() -> None:
    lines = table_lines([GOOD, BAD, Check("rest", "1", 0.0, 1e-13, 1e-6)])
    assert lines[2:] == [
        "| depth\\|a | 0.9 m | 0.901 m | 0.002 m | yes |",
        "| depth | 0.9 m | 0.8 m | 0.002 m | **no** |",
        "| rest | 0 | < 1e-9 | 1e-06 | yes |",
    ]


def test_the_page_has_a_table_for_every_topic() -> None:
    text = page_text({topic: [GOOD] for topic in TOPICS})
    assert text.count("| depth") == len(TOPICS)
    assert f"**{len(TOPICS)} of {len(TOPICS)} checks hold.**" in text
    assert not re.search(r"\{[a-z ]+\}", text)


def test_the_committed_page_was_made_by_the_command_and_all_holds() -> None:
    page = (ROOT / "docs" / PAGE).read_text(encoding="utf-8")
    held, count = map(int, re.findall(r"\*\*(\d+) of (\d+) checks hold", page)[0])
    assert held == count == page.count("| yes |")
    # Its text is the template's; only summary and tables are filled in.
    template = page_text({}).replace("0 of 0 checks hold.", f"{count} of {count} checks hold.")
    assert all(part in page for part in re.split(r"\{table [a-z]+\}", template))
    for picture in (ROOT / "docs" / PICTURES).iterdir():
        assert picture.stat().st_size < 150_000
        assert picture.name in page


def test_the_command_ends_with_3_when_something_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation, "TOPICS", {"depth": lambda: [GOOD, BAD]})
    result = CliRunner().invoke(app, ["validate"])
    assert result.exit_code == 3
    assert "1 of 2" in result.output


@pytest.mark.slow
def test_pictures_are_drawn(tmp_path: Path) -> None:
    checks = run_checks(["heights", "noise"])
    checks["drift"] = [Check("drift of a particle, T1-H1/16", "m/s", 0.05, 0.05, 1e-4)]
    checks["rays"] = [Check("rays meet the water, scene still", "px", 0.0, 1e-6, 0.001)]
    page, *pictures = validation.write_page(checks, tmp_path)
    assert page == tmp_path / PAGE
    assert len(pictures) == 10
    assert all(1_000 < picture.stat().st_size < 150_000 for picture in pictures)
    assert set(re.findall(r"validation/(\w+\.png)", page.read_text())) == {path.name for path in pictures}
