"""The documentation keeps its promises: links lead somewhere, the command reference is that of the program."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    broken = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert broken == []


def test_the_command_reference_is_up_to_date() -> None:
    made = subprocess.run(
        [sys.executable, "-m", "typer", "thermacq.cli.app", "utils", "docs", "--name", "thermacq"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "COLUMNS": "100", "NO_COLOR": "1"},
    ).stdout
    page = ROOT / "docs" / "reference" / "command-line.md"
    assert page.read_text(encoding="utf-8").split() == made.split(), "run `make docs`"


def test_the_readme_shows_its_two_commands_first() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert lines[3].startswith("make demo")
    assert lines[4].startswith("make test")


def test_every_module_stays_short() -> None:
    tracked = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split()
    if not tracked:
        pytest.skip("not a git checkout")
    long = {name: n for name in tracked if (n := len((ROOT / name).read_text().splitlines())) > 400}
    assert long == {}
