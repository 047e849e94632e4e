"""The acceptance table: limits, verdicts, and what is not known."""

from __future__ import annotations

from dataclasses import replace

import pytest

from thermacq_calibration import Board, StereoCalibration, ViewReport
from thermacq_calibration.geometry.acceptance import Verdict, acceptance, table_values, verdict


def views(count: int, tilt_deg: float = 30.0, outliers: int = 0, contrast: float = 600.0):
    used = [
        ViewReport(str(index), True, tilt_deg=tilt_deg, contrast=contrast, left_rms_px=0.1)
        for index in range(count)
    ]
    return (*used, *(ViewReport(f"o{index}", False, "outlier: far off") for index in range(outliers)))


@pytest.fixture
def excellent() -> StereoCalibration:
    return replace(
        StereoCalibration.from_rectified((640, 512), 700.0, None, 0.06),
        board=Board(9, 6, 0.05),
        rms_px=0.09,
        held_out_vertical_rms_px=0.08,
        coverage=(0.96, 1.0),
        views=views(40),
        poses=40,
        working_distance_m=0.65,
        half_set={"rms_px": 0.1},
        uncertainty={"standard": {"baseline_m": 2e-5, "depth_m": 2e-4}},
        counts_per_kelvin=100.0,
    )


def row(calibration, measure, **more):
    return next(one for one in acceptance(calibration, **more) if one.measure.startswith(measure))


def test_all_excellent_is_excellent(excellent):
    rows = acceptance(excellent, still_water_sigma_m=2.5e-4)
    assert len(rows) == 11
    assert {one.verdict for one in rows} == {Verdict.EXCELLENT}
    assert verdict(rows) is Verdict.EXCELLENT
    # Still water is not needed to judge a calibration.
    assert verdict(acceptance(excellent)) is Verdict.EXCELLENT


@pytest.mark.parametrize(
    ("measure", "passing", "failing"),
    [
        ("stereo RMS", {"rms_px": 0.25}, {"rms_px": 0.251}),
        ("held-out", {"held_out_vertical_rms_px": 0.25}, {"held_out_vertical_rms_px": 0.26}),
        (
            "baseline",
            {"uncertainty": {"standard": {"baseline_m": 1e-4}}},
            {"uncertainty": {"standard": {"baseline_m": 1.1e-4}}},
        ),
        (
            "depth-bias σ at 0.65 m",
            {"uncertainty": {"standard": {"depth_m": 5e-4}}},
            {"uncertainty": {"standard": {"depth_m": 6e-4}}},
        ),
        ("half-set", {"half_set": {"rms_px": 0.3}}, {"half_set": {"rms_px": 0.31}}),
        ("poses", {"poses": 25}, {"poses": 24}),
        (
            "tilt",
            {"views": views(20, 10.0) + views(10, 22.0)},
            {"views": views(20, 10.0) + views(9, 40.0)},
        ),
        ("coverage", {"coverage": (0.8, 1.0)}, {"coverage": (1.0, 0.79)}),
        ("outlier", {"views": views(97, outliers=3)}, {"views": views(96, outliers=4)}),
        ("board contrast", {"views": views(40, contrast=100.0)}, {"views": views(40, contrast=99.0)}),
    ],
)
def test_limits(excellent, measure, passing, failing):
    assert row(replace(excellent, **passing), measure).verdict is Verdict.PASS
    failed = replace(excellent, **failing)
    assert row(failed, measure).verdict is Verdict.FAIL
    assert verdict(acceptance(failed)) is Verdict.FAIL


def test_still_water(excellent):
    assert row(excellent, "still-water").verdict is Verdict.UNKNOWN
    assert row(excellent, "still-water", still_water_sigma_m=1.1e-3).verdict is Verdict.PASS
    assert row(excellent, "still-water", still_water_sigma_m=1.2e-3).verdict is Verdict.FAIL


def test_what_is_not_known_is_not_passed(excellent):
    blind = replace(excellent, uncertainty=None)
    assert row(blind, "baseline").value == "-"
    assert verdict(acceptance(blind)) is Verdict.UNKNOWN
    no_scale = replace(excellent, counts_per_kelvin=None)
    assert "counts per kelvin are not known" in row(no_scale, "board contrast").value
    assert verdict(acceptance(no_scale)) is Verdict.EXCELLENT


def test_repeated_poses_are_said(excellent):
    assert row(replace(excellent, poses=12), "poses").value == "12 different ones in 40 views"


def test_given_geometry_has_no_table():
    given = StereoCalibration.from_rectified((640, 512), 700.0, None, 0.06)
    assert acceptance(given) == []
    assert table_values([]) == {"verdict": "unknown", "rows": []}


def test_plain_values(excellent):
    values = table_values(acceptance(excellent))
    assert values["verdict"] == "excellent"
    assert values["rows"][0] == {
        "measure": "stereo RMS",
        "value": "0.090 px",
        "pass": "<= 0.25 px",
        "excellent": "<= 0.10 px",
        "verdict": "excellent",
    }
