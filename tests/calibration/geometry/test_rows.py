"""Rows of rectified pictures, matched on texture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from thermacq_calibration import CalibrationError
from thermacq_calibration.geometry.rows import RowDifferences, match_rows, row_agreement

SIZE = (320, 256)


def texture(seed=0):
    """Blobs of 4 to 12 px, counts."""
    random = np.random.default_rng(seed)
    fine, coarse = (cv2.GaussianBlur(random.normal(0, 1, SIZE[::-1]), (0, 0), sigma) for sigma in (2, 5))
    return 8000 + 300 * (fine / fine.std() + coarse / coarse.std())


def moved(picture, down, left=9.3):
    """The right picture: content moved down by (rows,) or one number of pixels, and to the left, by splines."""
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    return map_coordinates(picture, [rows - down, columns + left], order=5, mode="reflect")


@pytest.mark.parametrize("down", [-1.4, -0.2, 0.0, 0.6])
def test_known_offsets_are_found(down):
    left = texture()
    noise = np.random.default_rng(1).normal(0, 5, (2, *SIZE[::-1]))
    found = row_agreement([match_rows(left + noise[0], moved(left, down) + noise[1])], SIZE)
    # Left less right.
    assert found.median_px == pytest.approx(-down, abs=0.01)
    assert found.matches > 100
    assert found.mad_px < 0.05
    assert found.disparities_px == pytest.approx((9.3, 9.3), abs=0.1)
    assert found.fits == (abs(down) <= 0.25)


def test_negative_disparities_are_disparities():
    left = texture(2)
    found = row_agreement([match_rows(left, moved(left, 0.0, left=-14.0))], SIZE)
    assert found.disparities_px == pytest.approx((-14.0, -14.0), abs=0.1)
    assert found.median_px == pytest.approx(0, abs=0.03)


def test_a_trend_is_found_and_judged():
    left = texture(3)
    down = np.linspace(-0.8, 0.8, SIZE[1])[:, None]
    found = row_agreement([match_rows(left, moved(left, down))], SIZE)
    assert found.median_px == pytest.approx(0, abs=0.1)
    assert found.down_px == pytest.approx(-1.6, abs=0.15)
    assert found.across_px == pytest.approx(0, abs=0.1)
    assert found.systematic_px == pytest.approx(1.6 / np.sqrt(12), abs=0.1)
    assert not found.fits


def test_wrong_matches_do_not_move_the_median():
    random = np.random.default_rng(0)
    places = random.uniform(0, 200, (300, 2))
    rows = random.normal(-0.5, 0.1, 300)
    rows[:60] = random.uniform(-8, 8, 60)
    found = row_agreement([RowDifferences(places, rows, np.full(300, 7.0))], SIZE)
    assert found.median_px == pytest.approx(-0.5, abs=0.05)
    assert abs(found.across_px) < 0.15
    assert abs(found.down_px) < 0.15


def test_holes_of_rectification_are_left_out():
    left, right = texture(4), moved(texture(4), 0.5)
    right[:, :40] = np.nan
    left[200:] = np.nan
    found = match_rows(left, right)
    assert len(found.places) > 50
    assert found.places[:, 1].max() < 200
    assert np.median(found.rows_px) == pytest.approx(-0.5, abs=0.03)


def test_nothing_to_match_is_said():
    flat = np.full(SIZE[::-1], 9000.0)
    with pytest.raises(CalibrationError, match="only 0 places"):
        row_agreement([match_rows(flat, flat)], SIZE)
    with pytest.raises(CalibrationError, match="empty"):
        match_rows(flat * np.nan, flat)


def grey(path):
    picture = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return picture


def agreement(left, right):
    return row_agreement([match_rows(grey(left), grey(right))], grey(left).shape[::-1])


def test_a_real_thermal_pair_has_its_known_offset(shared_data):
    folder = shared_data / "ms2_thermal"
    found = agreement(folder / "left_000011_thr.png", folder / "right_000011_thr.png")
    # Known: median -0.6 px with a median deviation of 0.5 to 0.6 px, disparities 1 to 25 px.
    assert found.median_px == pytest.approx(-0.6, abs=0.15)
    assert found.mad_px == pytest.approx(0.5, abs=0.15)
    assert found.disparities_px[0] > 0
    assert found.disparities_px[1] < 26
    assert not found.fits


@pytest.mark.parametrize("number", [1, 2])
def test_real_pairs_with_negative_disparities(shared_data, number):
    folder = shared_data / "cats_thermal_stereo"
    found = agreement(folder / f"left_{number}.png", folder / f"right_{number}.png")
    # Known: 0.0 to -0.7 px over the four pairs of the set, disparities -32 to 3 px.
    assert -0.7 <= found.median_px <= 0.1
    assert found.disparities_px[0] < -10
    assert found.disparities_px[1] < 10
