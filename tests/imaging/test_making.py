from __future__ import annotations

import numpy as np
import pytest

from thermacq.errors import CorrectionError
from thermacq.imaging.making import make_corrections, save_together, update_correction
from thermacq.imaging.references import Reference
from thermacq_calibration import BadPixel, CalibrationError, load_correction


def made(blackbody, **more):
    return make_corrections(
        Reference(blackbody["cold"], 290.0),
        Reference(blackbody["hot"], 300.0),
        check=Reference(blackbody["check"], 295.0),
        **more,
    )


def test_gains_offsets_and_dead_pixels_are_those_of_the_formula(blackbody, sensors):
    for camera, one in made(blackbody).items():
        sensor, correction = sensors[camera], one.correction
        good = correction.bad_pixels == 0
        assert good.mean() > 0.99
        mean_gain = sensor.gain[good].mean()
        assert np.allclose(correction.gain[good], mean_gain / sensor.gain[good], rtol=0.01)
        assert correction.bad_pixels[20, 30] & BadPixel.DEAD
        assert correction.counts_per_kelvin == pytest.approx(100.0 * mean_gain, rel=0.002)
        assert one.checked.sigma_vh_per_netd < 0.25
        assert correction.made_from["runs"]["cold"]["run"] == blackbody["cold"].name
        assert correction.made_from["check"]["temperature_k"] == 295.0
        assert correction.serial == {"left": "SN1", "right": "SN2"}[camera]


def test_one_view_makes_offsets_only(blackbody):
    one = make_corrections(Reference(blackbody["cold"]))["left"]
    assert np.all(one.correction.gain == 1)
    assert one.checked is None


def test_cameras_are_found_by_serial_number_not_by_name(blackbody, write_run, sensors):
    def exchanged(camera, index):
        other = {"left": "right", "right": "left"}[camera]
        return sensors[other].counts(300.0, index)

    hot = write_run(exchanged, serials=("SN2", "SN1"))
    made_so = make_corrections(Reference(blackbody["cold"]), Reference(hot))["left"].correction
    good = made_so.bad_pixels == 0
    assert made_so.gain[good].std() == pytest.approx((1 / sensors["left"].gain[good]).std(), rel=0.1)


def test_views_of_other_cameras_are_refused(blackbody, write_run):
    other = write_run(300.0, serials=("SN1", "SN9"))
    with pytest.raises(CorrectionError, match=r"camera 'right' \(serial SN2\).*did not take part"):
        make_corrections(Reference(blackbody["cold"]), Reference(other))


@pytest.mark.parametrize("known", [True, False])
def test_exchanged_views_are_refused(blackbody, known):
    cold, hot = (
        Reference(blackbody[name], kelvin if known else None)
        for name, kelvin in (("cold", 290.0), ("hot", 300.0))
    )
    with pytest.raises(CorrectionError, match="is warmer than"):
        make_corrections(hot, cold)


def test_equal_temperatures_are_refused(blackbody):
    with pytest.raises(CalibrationError, match="gains would be noise"):
        make_corrections(Reference(blackbody["cold"], 290.0), Reference(blackbody["cold"], 290.0))


def test_an_update_changes_offsets_and_says_from_what(blackbody, write_run, sensors):
    old = made(blackbody)["left"].correction
    sensors["left"].offset += 40 * np.random.default_rng(3).standard_normal(sensors["left"].offset.shape)
    new = update_correction(old, Reference(write_run(294.0, start_s=600), 294.0), behind_lens=False)
    assert np.array_equal(new.gain, old.gain)
    assert not np.array_equal(new.offset, old.offset)
    assert new.offset_updated
    assert new.made_from["offset_run"]["middle_time"].startswith("2026-01-02T03:14")
    picture = new.gain * sensors["left"].counts(297.0, 77) + new.offset
    good = new.bad_pixels == 0
    assert picture[good].std() < 1.5 * 3.5
    assert new.to_kelvin(picture)[good].mean() == pytest.approx(297.0, abs=0.02)


def test_all_files_are_written_or_none(blackbody, tmp_path):
    corrections = [one.correction for one in made(blackbody).values()]
    good, bad = tmp_path / "a.correction.h5", tmp_path / "no" / "b.correction.h5"
    with pytest.raises(CalibrationError):
        save_together({good: corrections[0], bad: corrections[1]})
    assert not good.exists()
    good.touch()
    with pytest.raises(CorrectionError, match="exists"):
        save_together({tmp_path / "c.correction.h5": corrections[1], good: corrections[0]})
    assert not (tmp_path / "c.correction.h5").exists()
    save_together({tmp_path / "d.correction.h5": corrections[0]})
    assert load_correction(tmp_path / "d.correction.h5").sha256 == corrections[0].sha256
