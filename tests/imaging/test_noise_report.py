"""The noise report of runs whose noise is known: figures, warnings, refusals, drawings."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from thermacq.errors import CorrectionError, StoreError
from thermacq.imaging.making import make_corrections
from thermacq.imaging.noise_drawing import save_report
from thermacq.imaging.noise_report import noise_report
from thermacq.imaging.noise_tables import camera_rows, component_rows
from thermacq.imaging.references import Reference
from thermacq_calibration import CalibrationError
from thermacq_calibration.infrared.noise import COMPONENTS

# Of the cameras in conftest.py.
DEAD = (20, 30)
NETD_K = 0.035


@pytest.fixture
def views(blackbody):
    """The three views, as they are given for the scale."""
    kelvin = {"cold": 290.0, "check": 295.0, "hot": 300.0}
    return [Reference(blackbody[name], temperature_k) for name, temperature_k in kelvin.items()]


def test_raw_pictures_with_a_scale_of_three_views(write_run, views) -> None:
    report = noise_report(Reference(write_run(295.0, frames=64, start_s=9.0), 295.0), sitf=views)
    assert [camera.camera for camera in report.cameras] == ["left", "right"]
    for camera in report.cameras:
        assert camera.warnings == ()
        assert camera.sitf.counts_per_kelvin == pytest.approx(100.0, rel=0.005)
        assert camera.netd_k.value == pytest.approx(NETD_K, rel=0.01)
        assert camera.netd_from_differences_k.value == pytest.approx(camera.netd_k.value, rel=0.01)
        # 150 counts of offset, whose zero is at 295 K.
        assert camera.rnu_k.value == pytest.approx(1.5, rel=0.06)
        assert camera.rnu_per_cent == pytest.approx(100 * 150 / 6000, rel=0.06)
        assert camera.bad_pixels[DEAD] > 0
        assert camera.bad_counts()["dead"] == 1
        assert np.count_nonzero(camera.bad_pixels) <= 3
        assert camera.corrected == ()
        assert len(camera.time_s) == len(camera.level_counts) == 64
        assert camera.fpa_temperature_k[0] == 305.0
        white = camera.along_rows.temporal
        assert np.median(white) == pytest.approx(2 * 3.5**2, rel=0.1)
        assert len(white) == 32


def test_a_correction_takes_the_pattern_away_and_brings_its_scale(write_run, blackbody) -> None:
    made = make_corrections(Reference(blackbody["cold"], 290.0), Reference(blackbody["hot"], 300.0))
    run = write_run(
        294.0, frames=64, start_s=9.0, corrections={name: one.correction for name, one in made.items()}
    )
    corrected = noise_report(Reference(run)).cameras[0]
    raw = noise_report(Reference(run), correct=False).cameras[0]
    assert corrected.sitf_from == "the correction"
    assert corrected.netd_k.value == pytest.approx(NETD_K, rel=0.02)
    # The floor of a two-point correction from 32 frames each that have the same noise.
    assert corrected.rnu_k.value == pytest.approx(NETD_K / np.sqrt(32), rel=0.1)
    assert raw.sitf is None
    assert raw.noise.vh.sigma > 100 * corrected.noise.vh.sigma
    assert "nonuniformity" in corrected.corrected
    assert raw.corrected == ()


def test_without_a_scale_figures_are_in_counts_and_say_so(write_run) -> None:
    camera = noise_report(Reference(write_run(295.0, frames=20))).cameras[0]
    assert camera.netd_k is camera.rnu_k is None
    rows = dict(camera_rows(camera))
    assert "in counts" in rows["SiTF"]
    assert "NETD" not in rows
    lines = component_rows(camera)
    assert [line[0] for line in lines] == list(COMPONENTS)
    assert lines[-1][1].endswith(" counts")
    assert any("20 frames are few" in warning for warning in camera.warnings)
    negative = [line for line in lines if camera.noise.component(line[0]).is_negative]
    assert all(line[1].startswith("0 (negative") for line in negative)


def test_frames_of_the_shutter_and_repeated_ones_are_left_out(write_run, sensors, shutter_flag) -> None:
    def shown(camera, index):
        return sensors[camera].counts(295.0, index - index % 4 if index >= 40 else index)

    run = write_run(shown, frames=80, flags=lambda index: shutter_flag if index < 10 else 0)
    camera = noise_report(Reference(run), counts_per_kelvin=100.0).cameras[0]
    # 30 open ones, then every fourth is new.
    assert camera.noise.shape[0] == 30 + 10
    assert camera.netd_k.value == pytest.approx(NETD_K, rel=0.02)


def test_a_scene_is_neither_uniform_nor_static(write_run) -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, (48, 200)), (0, 0), 2)
    texture *= 0.5 / texture.std()

    def moving(_camera, index):
        return 295.0 + texture[:, index // 2 : index // 2 + 64]

    def still(_camera, _index):
        return 295.0 + 20 * texture[:, :64]

    found = noise_report(Reference(write_run(moving, frames=64))).cameras[0].warnings
    assert any("not static" in warning for warning in found)
    found = noise_report(Reference(write_run(still, frames=64))).cameras[0].warnings
    assert any("not uniform" in warning for warning in found)
    assert not any("not static" in warning for warning in found)


def test_what_is_no_view_is_refused(write_run, views, tmp_path) -> None:
    full = np.full((48, 64), 16383, np.uint16)
    with pytest.raises(CalibrationError, match="constant: 100% of the pixels have the count 16383"):
        noise_report(Reference(write_run(lambda _c, _i: full)))
    with pytest.raises(CalibrationError, match="fewer than 16"):
        noise_report(Reference(write_run(295.0, frames=5)))

    def saturated(camera, index):
        counts = full.copy()
        counts[:40] -= np.random.default_rng(index).integers(0, 9, (40, 64)).astype(np.uint16)
        return counts

    with pytest.raises(CalibrationError, match="saturated"):
        noise_report(Reference(write_run(saturated)))
    run = write_run(295.0, frames=20)
    with pytest.raises(StoreError, match="no run file"):
        noise_report(Reference(tmp_path / "none.h5"))
    with pytest.raises(CorrectionError, match="no scale"):
        noise_report(Reference(run), counts_per_kelvin=0.0)
    with pytest.raises(CorrectionError, match="is not known"):
        noise_report(Reference(run), sitf=[*views[:2], Reference(run)])
    with pytest.raises(CalibrationError, match="3 different temperatures"):
        noise_report(Reference(run), sitf=views[:2])


@pytest.mark.slow
def test_a_report_is_drawn_and_told(write_run, views, tmp_path) -> None:
    report = noise_report(Reference(write_run(295.0, frames=40), 295.0), sitf=views)
    facts = json.loads(json.dumps(report.facts(), allow_nan=False))
    assert facts["simulated"] is True
    assert facts["cameras"][0]["netd_k"]["value"] == pytest.approx(NETD_K, rel=0.02)
    assert set(facts["cameras"][0]["noise_3d"]) == set(COMPONENTS)
    report = replace(report, cameras=report.cameras[:1])
    save_report(report, tmp_path / "noise.png")
    drawn = cv2.imread(str(tmp_path / "noise.png"))
    assert drawn.shape[1] == 1300
    assert drawn.std() > 20
    save_report(report, tmp_path / "noise.html")
    page = (tmp_path / "noise.html").read_text()
    assert page.count("data:image/png;base64,") == 1
    assert "simulated cameras" in page
    assert "NETD" in page
    with pytest.raises(StoreError, match="exists already"):
        save_report(report, tmp_path / "noise.png")
    with pytest.raises(CorrectionError, match="neither"):
        save_report(report, tmp_path / "noise.pdf")
