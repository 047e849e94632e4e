"""The report in a real browser: it is drawn, fits narrow screens, and asks for nothing from outside."""

import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from thermacq.report.page import render

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
]


@pytest.mark.slow
@pytest.mark.parametrize("width", [1200, 400])
def test_the_page_is_drawn(full_data, tmp_path: Path, width: int) -> None:
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    page, picture = tmp_path / "report.html", tmp_path / "report.png"
    page.write_text(render(full_data), encoding="utf-8")
    done = subprocess.run(
        [
            CHROMIUM,
            *QUIET,
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--window-size={width},3000",
            f"--screenshot={picture}",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert picture.exists(), done.stderr
    assert not re.search(r"CONSOLE.*(Refused|Error|Failed)", done.stderr)
    drawn = cv2.imread(str(picture))
    assert drawn is not None
    assert drawn.shape[1] >= width
    background = drawn[5, 5].astype(int)
    # Text and figures all the way down, and a margin on the right: nothing hangs over the edge.
    differs = np.abs(drawn.astype(int) - background).max(axis=2) > 40
    rows = differs.any(axis=1).reshape(-1, 300).mean(axis=1)
    assert np.all(rows > 0.1)
    assert not differs[:, -4:].any()
