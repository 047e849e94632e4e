from __future__ import annotations

import numpy as np
import pytest

from thermacq.errors import ReconstructionError, StoreError
from thermacq.evaluation.run_comparison import CompareSettings, compare_run
from thermacq.reconstruction import open_product
from thermacq.store import RunFile, open_run

QUICK = CompareSettings(resamples=50)


def test_stereo_probe_and_truth(measured_wave, known_truth):
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        found = compare_run(product, run, settings=QUICK)
    names = [(item.measured_name, item.reference_name) for item in found.comparisons]
    truth = "truth (simulated) at probe P1"
    assert names == [("stereo", "probe P1"), ("stereo", truth), ("probe P1", truth)]
    against_probe, against_truth, probe = found.comparisons
    # The product was made 2 % too low, the probe reads 1 % too high.
    assert against_truth.agreement.slope == pytest.approx(0.98, abs=1e-3)
    assert probe.agreement.slope == pytest.approx(1.01, abs=1e-3)
    assert against_probe.agreement.slope == pytest.approx(0.98 / 1.01, abs=1e-3)
    assert against_probe.lag.lag_s == pytest.approx(0, abs=1e-3)
    assert found.notes == ()
    assert [record.name for record in found.probes] == ["P1"]


def test_truth_can_be_left_out(measured_wave, known_truth):
    settings = CompareSettings(resamples=50, truth=False)
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        found = compare_run(product, run, settings=settings)
    assert len(found.comparisons) == 1


def test_noise_that_makes_waves_is_noted(measured_wave, known_truth):
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        noise = np.random.default_rng(0).normal(0, 0.012, product["eta"].shape)
        noisy = product.assign(eta=product["eta"] + noise)
        found = compare_run(noisy, run, settings=QUICK)
        calm = compare_run(noisy, run, settings=CompareSettings(resamples=50, dead_band_m=0.03))
    assert any(note.startswith("stereo: noise makes waves") for note in found.notes)
    assert calm.notes == ()
    assert calm.comparisons[0].period_error == pytest.approx(0, abs=0.02)


def test_another_place_is_stated(measured_wave, known_truth):
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        found = compare_run(product, run, probe="P1", place=(0.25, 0.0), settings=QUICK)
    assert (
        "the surface was read at x = 0.250 m, y = 0.000 m, probe P1 stands at x = 0.300 m" in found.notes[0]
    )
    expected_lag = -0.05 * measured_wave.wave_number / measured_wave.angular_frequency
    assert found.comparisons[0].lag.lag_s == pytest.approx(expected_lag, abs=1e-3)


def test_a_probe_outside_the_surface_is_explained(measured_wave):
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        with pytest.raises(ReconstructionError, match=r"x = 9 m lies outside"):
            compare_run(product, run, place=(9, 0), settings=QUICK)
        with pytest.raises(StoreError, match="no probe 'P2'"):
            compare_run(product, run, probe="P2", settings=QUICK)


def test_product_and_run_must_belong_together(measured_wave):
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        product.attrs["run_id"] = "another"
        with pytest.raises(StoreError, match="not made from"):
            compare_run(product, run)


def test_a_truth_that_fails_costs_only_the_truth(measured_wave, monkeypatch):
    class Plugins:
        def truth(self, request):
            raise ZeroDivisionError("the sea is empty")

    monkeypatch.setattr("thermacq.evaluation.run_comparison.plugins", Plugins)
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        found = compare_run(product, run, settings=QUICK)
    assert len(found.comparisons) == 1
    assert "the sea is empty" in found.notes[0]


def test_a_useless_probe_leaves_the_truth(measured_wave, known_truth, monkeypatch):
    def fail(run, name):
        raise StoreError("it is silent")

    monkeypatch.setattr("thermacq.evaluation.run_comparison.probe_record", fail)
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        found = compare_run(product, run, settings=QUICK)
    assert [item.reference_name for item in found.comparisons] == ["truth (simulated) at probe P1"]
    assert found.notes == ("probe P1 is not compared: it is silent",)


@pytest.mark.parametrize(("truth", "count"), [(True, 1), (False, 0)])
def test_a_run_without_probes(measured_wave, known_truth, monkeypatch, truth, count):
    monkeypatch.setattr(RunFile, "probes", property(lambda run: ()))
    settings = CompareSettings(resamples=50, truth=truth)
    with open_product(measured_wave.product) as product, open_run(measured_wave.run) as run:
        if not count:
            with pytest.raises(ReconstructionError, match="no wave probe"):
                compare_run(product, run, settings=settings)
            return
        found = compare_run(product, run, settings=settings)
    assert len(found.comparisons) == count
    assert found.comparisons[0].reference_name.startswith("truth (simulated) at x = 0.300 m, y = ")
