from __future__ import annotations

import numpy as np
import pytest

from thermacq.errors import CorrectionError
from thermacq.imaging.condition import judge_correction
from thermacq.imaging.correction_picture import draw_correction
from thermacq.imaging.making import make_corrections
from thermacq.imaging.references import Reference


@pytest.fixture
def correction(blackbody):
    return make_corrections(
        Reference(blackbody["cold"], 290.0),
        Reference(blackbody["hot"], 300.0),
        check=Reference(blackbody["check"], 295.0),
    )["left"].correction


def test_a_fresh_correction_serves(correction, write_run):
    judged = judge_correction(correction, [Reference(write_run(294.0, start_s=300), 294.0)], 600)
    assert judged.warnings == ()
    assert judged.age_s == pytest.approx(300, abs=1)
    assert judged.warming_k == pytest.approx(0, abs=1e-6)
    assert judged.new_bad_pixels <= 3
    assert judged.predicted_netd < 0.5


def test_a_pattern_that_came_since_is_told_and_extended(correction, write_run, sensors):
    sensors["left"].offset += 1.2 * np.random.default_rng(5).standard_normal(sensors["left"].offset.shape)
    judged = judge_correction(correction, [Reference(write_run(295.0, start_s=300), 295.0)], 600)
    assert judged.growth_netd == pytest.approx(1.2 / 3.5, rel=0.15)
    assert judged.predicted_netd == pytest.approx(2 * judged.growth_netd, rel=0.02)
    assert any("may grow" in warning for warning in judged.warnings)
    assert judge_correction(correction, [Reference(write_run(295.0, start_s=300))], 60).warnings == ()


def test_views_at_four_ages_measure_the_growth(correction, write_run, sensors):
    pattern = np.random.default_rng(6).standard_normal(sensors["left"].offset.shape)
    references = []
    for minutes, more in ((5, 0.4), (10, 0.4), (15, 0.4), (20, 0.4)):
        sensors["left"].offset += more * pattern
        references.append(Reference(write_run(295.0, frames=64, start_s=60 * minutes), 295.0))
    judged = judge_correction(correction, references, 600)
    # 0.4 counts in 5 minutes, so 0.8 in the next ten, of 3.5 counts of noise.
    assert judged.predicted_netd == pytest.approx(0.8 / 3.5, rel=0.4)


def test_a_warmer_camera_and_a_large_residual_are_warned_of(correction, write_run, sensors):
    sensors["left"].offset += 5 * np.random.default_rng(7).standard_normal(sensors["left"].offset.shape)
    judged = judge_correction(correction, [Reference(write_run(295.0, inside_k=307.0))], 0)
    assert judged.warming_k == pytest.approx(2.0)
    text = " ".join(judged.warnings)
    assert "residual non-uniformity" in text
    assert "focal plane is +2.00 K" in text


def test_a_scene_is_no_uniform_view(correction, write_run):
    # Lamps, wires, ripples: a few strong points, that no sensor would show.
    scene = 295.0 + np.clip(np.random.default_rng(8).standard_normal((48, 64)) ** 3, -20, 20)
    with pytest.raises(CorrectionError, match="far from uniform"):
        judge_correction(correction, [Reference(write_run(lambda _camera, _index: scene.copy()))], 0)


def test_the_picture_is_a_png(correction, tmp_path):
    draw_correction(correction, tmp_path / "c.png")
    assert (tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")
