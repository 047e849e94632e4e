from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from thermacq_drivers.simflume.contact_sheet import draw_contact_sheet

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
def test_the_sheet_in_the_docs_is_what_the_simulator_draws(tmp_path: Path) -> None:
    draw_contact_sheet(tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").stat().st_size < 400_000
    drawn, kept = (
        cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(float)
        for path in (tmp_path / "sheet.png", ROOT / "docs" / "pictures" / "contact-sheet.png")
    )
    assert drawn.shape == kept.shape
    # Fonts and rounding may differ from machine to machine; pictures may not.
    assert np.corrcoef(drawn.ravel(), kept.ravel())[0, 1] > 0.97
