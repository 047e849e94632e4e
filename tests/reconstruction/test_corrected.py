"""Reconstruction of corrected pictures: what goes in, what comes out, and what the product says of it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.reconstruction import match_pair, open_product, open_source
from thermacq.reconstruction.matching import PairReader
from thermacq.report.provenance import _correction
from thermacq.store import CameraStream, FrameRow, RunWriter, open_run
from thermacq_calibration import CalibrationError, CameraCorrection

COUNTS_PER_K = 100.0


@pytest.fixture(scope="module")
def dirty(still_run, tmp_path_factory):
    """The still-water run as two cameras with a strong fixed pattern saw it, and the corrections for it."""
    folder = tmp_path_factory.mktemp("dirty")
    random = np.random.default_rng(11)
    path, files = folder / "dirty.h5", []
    with open_run(still_run) as run:
        streams, patterns = [], {}
        for name in run.cameras:
            stream = run.camera(name)
            shape = stream.rows, stream.columns
            gain = 1 + 0.05 * random.standard_normal(shape)
            offset = 150 * random.standard_normal(shape)
            patterns[name] = gain, offset
            streams.append(CameraStream(name, *shape, identity={"serial": f"SN-{name}"}))
            correction = CameraCorrection(
                f"SN-{name}", name, 1 / gain, 6000 - (6000 + offset) / gain, np.zeros(shape, np.uint8)
            )
            files.append(folder / f"{name}.correction.h5")
            correction.save(files[-1])
        with RunWriter.create(path, run.header, streams) as writer:
            for index in range(3):
                for name, (gain, offset) in patterns.items():
                    clean = run.counts(name, index).astype(float)
                    seen = np.rint(6000 + offset + gain * (clean - 6000)).clip(0, 65535).astype(np.uint16)
                    row = FrameRow(index, -1, 20_000_000 * index, index, 20_000_000 * index)
                    writer.append_frame(name, seen, row)
            writer.finish({}, "done")
    return path, files


def deviation_px(dirty_path, clean_path, **options):
    """Spread of the difference between the disparity of a run and that of the clean pictures; NaN: nothing matched."""
    settings = {"min_disparity": 20, "max_disparity": 52}
    clean = match_pair(open_source(clean_path, settings=settings)).disparity
    found = match_pair(open_source(dirty_path, settings=settings, **options)).disparity
    return np.isfinite(found).mean(), float(np.nanstd(found - clean))


def test_corrected_pictures_match_as_clean_ones_do(dirty, still_run):
    path, files = dirty
    density, spread = deviation_px(path, still_run, correction_files=files)
    assert density > 0.5
    assert spread < 0.01
    with pytest.raises(Exception, match="found nothing"):
        deviation_px(path, still_run, correct=False)


def test_everything_stands_in_the_provenance_and_in_the_key(dirty):
    path, files = dirty
    settings = {"min_disparity": 20, "max_disparity": 52}
    raw, corrected = (
        open_source(path, settings=settings, correct=correct, correction_files=files)
        for correct in (False, True)
    )
    assert raw.provenance()["correction"]["from"] == "none"
    told = corrected.provenance()["correction"]
    assert set(told["cameras"]) == {"left", "right"}
    assert raw.key(raw.pairs) != corrected.key(corrected.pairs)
    with PairReader(path, corrected.calibration, corrected.pairs, corrected.corrections) as reader:
        left, _ = reader.read(0)
    assert float(np.nanstd(left)) < 3 * 0.3 * COUNTS_PER_K


def test_the_commands_take_files_or_none(dirty, tmp_path):
    path, files = dirty
    words = ["reconstruct", path, "-o", tmp_path / "eta.nc", "--workers", 1, "--frames", "0:2"]
    words += ["--set", "min_disparity=20", "--set", "max_disparity=52"]
    options = [word for file in files for word in ("--correction", file)]
    result = CliRunner().invoke(app, [str(word) for word in words + options])
    assert result.exit_code == 0, result.output
    with open_product(tmp_path / "eta.nc") as product:
        told = json.loads(product.attrs["correction"])
        assert told["from"] == "files"
        assert json.loads(product.attrs["world_frame"])["source"]["correction"] == told
        lines = _correction(product)
        assert lines["left: stages"] == "nonuniformity, bad-pixels"
        assert lines["left: SHA-256"] == told["cameras"]["left"]["sha256"]
        # A product from elsewhere may say anything.
        for damaged in ('{"cameras": 5}', '{"cameras": {"left": 1}}', '{"stages": [1]}'):
            assert _correction(product.assign_attrs(correction=damaged)) == {"applied": "unknown"}
    words[3] = tmp_path / "other.nc"
    both = CliRunner().invoke(app, [str(word) for word in [*words, *options, "--no-correction"]])
    assert both.exit_code == 2
    missing = CliRunner().invoke(
        app, [str(word) for word in [*words[:3], tmp_path / "x.nc", "--correction", "no"]]
    )
    assert isinstance(missing.exception, CalibrationError)
