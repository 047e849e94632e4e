"""The main job, end to end, through the commands that a user types, against the simulated truth."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from thermacq.reconstruction import open_product
from thermacq.store import open_run

WAVE_HEIGHT_M = 0.0822
PERIOD_S = 0.791


def thermacq(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "thermacq", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("demo")
    done = thermacq(folder, "demo", "--output", "out")
    assert done.returncode == 0, done.stderr
    return folder / "out", done.stdout


@pytest.mark.slow
@pytest.mark.timeout(1200)
class TestDemo:
    def test_prints_the_table_and_where_the_report_is(self, demo: tuple[Path, str]) -> None:
        _, printed = demo
        assert "stereo / probe" in printed
        assert "truth (simulated)" in printed
        assert "report.html" in printed.splitlines()[-1]

    def test_nothing_was_lost(self, demo: tuple[Path, str]) -> None:
        folder, _ = demo
        with open_run(folder / "wave.h5") as run:
            assert run.complete
            assert run.frame_count("left") == run.frame_count("right") == 400

    def test_agrees_with_the_simulated_truth_better_than_the_paper_did(self, demo: tuple[Path, str]) -> None:
        folder, _ = demo
        done = thermacq(folder, "compare", "wave.nc", "wave.h5", "--json")
        assert done.returncode == 0, done.stderr
        truth = next(
            item
            for item in json.loads(done.stdout)["comparisons"]
            if item["measured"] == "stereo" and item["reference"].startswith("truth")
        )
        assert abs(truth["agreement"]["slope"] - 1) < 0.01
        assert truth["agreement"]["r_squared"] > 0.995
        assert truth["agreement"]["rmse_m"] < 0.001
        measured = truth["measured_waves"]
        assert abs(measured["mean_height_m"] / WAVE_HEIGHT_M - 1) < 0.02
        assert abs(measured["mean_period_s"] / PERIOD_S - 1) < 0.005

    def test_still_water_is_flat_and_level_zero(self, demo: tuple[Path, str]) -> None:
        folder, _ = demo
        with open_product(folder / "still.nc") as product:
            eta_m = product["eta"].load()
        assert abs(float(eta_m.median())) < 2e-4
        assert float(eta_m.std()) < 1e-3

    def test_the_report_stands_alone(self, demo: tuple[Path, str]) -> None:
        folder, _ = demo
        page = (folder / "report.html").read_text(encoding="utf-8")

        class Resources(HTMLParser):
            found: list[str] = []  # noqa: RUF012

            def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
                for name, value in attrs:
                    if name in ("src", "href") and value and not value.startswith(("data:", "#")):
                        self.found.append(f"{tag} {value}")

        parser = Resources()
        parser.feed(page)
        assert parser.found == []
        assert len(page) < 6_000_000
        assert "Simulated" in page

    def test_the_example_of_the_readme_runs(self, demo: tuple[Path, str]) -> None:
        folder, _ = demo
        readme = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
        example = readme.split("```python\n")[1].split("```")[0]
        assert len(example.splitlines()) <= 10
        done = subprocess.run(
            [sys.executable, "-c", example.replace("demo-output", str(folder))],
            capture_output=True,
            text=True,
            check=True,
        )
        assert re.match(r"0\.0[45]\d\d m at the highest crest, from 400 frames", done.stdout)

    def test_may_be_repeated_but_never_empties_a_foreign_folder(self, tmp_path: Path) -> None:
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "thesis.txt").write_text("years of work")
        done = thermacq(tmp_path, "demo", "--output", "mine")
        assert done.returncode == 1
        assert "was not made by the demo" in done.stderr
        assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"
