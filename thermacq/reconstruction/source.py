"""What is reconstructed: a run, its pairs, its calibration and the complete settings of the matcher."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thermacq import __version__
from thermacq.imaging import Corrections, corrections_of, doubts
from thermacq.reconstruction.matching import MatchingJob, PairReader, complete_settings
from thermacq.reconstruction.pairs import RunPairs, find_calibration, run_pairs, select_frames
from thermacq.rig import Rig
from thermacq.store import RunHeader, open_run
from thermacq_calibration import Rectification, StereoCalibration


@dataclass(frozen=True)
class Source:
    """A run ready to be matched; make it with `open_source`. `doubts` are sentences for the user."""

    run_path: Path
    run_sha256: str
    header: RunHeader
    rig: Rig
    calibration: StereoCalibration
    rectification: Rectification
    pairs: RunPairs
    matcher: str
    settings: dict[str, Any]
    corrections: Corrections
    doubts: tuple[str, ...] = ()

    def job(self, pairs: RunPairs) -> MatchingJob:
        """What worker processes need to match some of the pairs."""
        return MatchingJob(
            self.run_path, self.calibration.to_dict(), self.matcher, self.settings, pairs, self.corrections
        )

    def provenance(self) -> dict[str, Any]:
        """Where a product of this source comes from, as plain values."""
        return {
            "run": self.run_path.name,
            "run_id": self.header.run_id,
            "run_sha256": self.run_sha256,
            "cameras": f"{self.pairs.left_camera},{self.pairs.right_camera}",
            "calibration_sha256": self.calibration.sha256,
            "matcher": self.matcher,
            "matcher_settings": self.settings,
            "correction": self.corrections.provenance(),
            "simulated": self.header.simulated,
            "thermacq_version": __version__,
        }

    def key(self, pairs: RunPairs, **more: Any) -> str:
        """Short hash of everything that a result depends on; names the folder of its parts."""
        content = {
            **self.provenance(),
            "pairs": [pairs.left.tolist(), pairs.right.tolist()],
            **more,
        }
        text = json.dumps(content, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def open_source(
    run_path: Path,
    *,
    calibration: Path | None = None,
    frames: str | None = None,
    matcher: str | None = None,
    settings: Mapping[str, Any] | None = None,
    pair: str | None = None,
    correction_files: Sequence[Path] = (),
    correct: bool = True,
) -> Source:
    """Check that a run can be reconstructed and complete the settings.

    Parameters
    ----------
    run_path
        The run file.
    calibration
        Calibration record; None: the one stored with the run.
    frames
        Range of pairs ``A:B``; None: all.
    matcher
        Name of the matcher; None: the rig's.
    settings
        Its settings, over those of the rig when the matcher is the rig's.
    pair
        Which pair of cameras, where there are several; see `camera_sides`.
    correction_files
        Corrections of the cameras' pictures; empty: those stored with the run.
    correct
        False: pictures as the cameras delivered them.

    Raises
    ------
    ThermacqError
        Something is missing, damaged or does not fit.
    thermacq_calibration.CalibrationError
        The calibration record or a correction is damaged, or of a rig that cannot be rectified.
    """
    with open_run(run_path) as run:
        rig = run.rig
        record = find_calibration(run, calibration, pair)
        pairs = select_frames(run_pairs(run, pair), frames)
        corrections = corrections_of(run, correction_files, use=correct)
        doubtful = doubts(run, (pairs.left_camera, pairs.right_camera), corrections)
        header, run_sha256 = run.header, run.sha256()
    table = rig.reconstruction
    name = matcher or table.matcher
    wanted = {**(table.matcher_settings if name == table.matcher else {}), **(settings or {})}
    with PairReader(run_path, record, pairs, corrections) as reader:
        complete = complete_settings(reader, len(pairs), name, wanted)
        rectification = reader.rectification
    return Source(
        run_path, run_sha256, header, rig, record, rectification, pairs, name, complete, corrections, doubtful
    )
