"""The page about a calibration."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.report.calibration_page import ShownView, render, views_to_show, write_calibration_page
from thermacq_calibration import NoBoard, StereoCalibration, calibrate_stereo, load_calibration
from thermacq_calibration.geometry.residuals import residuals

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def record(pair) -> StereoCalibration:
    """Twelve views, one without board, one with a markup character in its name."""
    views = pair.views(12, 0.1, seed=1)
    views[3] = replace(views[3], right=NoBoard("too blurred"))
    views[5] = replace(views[5], name="<i>05</i>")
    return calibrate_stereo(views, pair.board, (640, 512), "a & b", replicates=20)


def test_the_page_says_everything_and_needs_nothing(record) -> None:
    picture = np.random.default_rng(0).normal(8000, 20, (512, 640))
    page = render(record, [ShownView("<i>05</i>", picture, picture)])
    assert "Stereo calibration: fail" in page
    assert "a &amp; b" in page
    assert "View &lt;i&gt;05&lt;/i&gt;, used" in page
    assert "<i>05" not in page
    assert "right: too blurred" in page
    assert page.count("<svg") == 4
    assert page.count("data:image/jpeg") == 2
    assert record.sha256 in page
    assert "Only 11 views were used" in page
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "<script" not in page


def test_residuals_come_from_the_record_alone(record, tmp_path: Path) -> None:
    record.save(tmp_path / "cal.json")
    found = residuals(load_calibration(tmp_path / "cal.json"))
    assert [view.used for view in found] == [True] * 11
    errors = np.vstack([np.hstack([view.left_error_px, view.right_error_px]) for view in found])
    # Corners are stored to 0.001 px.
    assert np.sqrt(np.sum(errors**2) / (2 * len(errors))) == pytest.approx(record.rms_px, abs=1e-4)


def test_left_out_and_worst_views_are_worth_a_look(record) -> None:
    names = views_to_show(record)
    assert names[0] == "03"
    assert len(names) == len(set(names)) == 4
    worst = max(
        (view for view in record.views if view.used), key=lambda v: max(v.left_rms_px, v.right_rms_px)
    )
    assert names[1] == worst.name


def test_a_record_that_knows_little_has_a_page(tmp_path: Path) -> None:
    given = StereoCalibration.from_rectified((640, 512), 700.0, None, 0.06)
    page = render(given)
    assert "given, not measured" in page
    assert "<svg" not in page


def test_what_cannot_be_written_is_said(record, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot be written"):
        write_calibration_page(record, tmp_path / "no" / "page.html")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("width", [1200, 400])
def test_the_page_is_drawn(record, tmp_path: Path, width: int) -> None:
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    page, picture = tmp_path / "page.html", tmp_path / "page.png"
    write_calibration_page(record, page)
    quiet = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars"]
    quiet += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    place = [f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}"]
    done = subprocess.run(
        [CHROMIUM, *quiet, *place, f"--window-size={width},3000", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert picture.exists(), done.stderr
    assert not re.search(r"CONSOLE.*(Refused|Error|Failed)", done.stderr)
    drawn = cv2.imread(str(picture))
    assert drawn is not None
    differs = np.abs(drawn.astype(int) - drawn[5, 5].astype(int)).max(axis=2) > 40
    assert np.all(differs.any(axis=1).reshape(-1, 300).mean(axis=1) > 0.1)
    assert not differs[:, -4:].any()
