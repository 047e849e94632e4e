"""The calibration of a stereo pair as an immutable, hashed record, and its JSON file.

A record is made by `thermacq_calibration.geometry.stereo.calibrate_stereo` or `StereoCalibration.from_rectified`,
never changed, and stored in every recording that it was used for. Pixel coordinates follow OpenCV: the
centre of the upper left pixel is (0, 0), u to the right, v down.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.fields import Fields, parse_json
from thermacq_calibration.files import new_file, read_text
from thermacq_calibration.models import (
    Board,
    CameraModel,
    Float,
    ViewReport,
    board_dict,
    board_from,
    camera_dict,
    camera_from,
    frozen_array,
    view_from,
)

FORMAT = "thermacq-stereo-calibration"
VERSION = 2
_READABLE = (1, 2)
# A record of 200 views with their corners has about 1 MB; anything far larger is no record.
_MAX_FILE_BYTES = 16 * 1024 * 1024
_LARGEST_M = 1e6


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """Geometry of two cameras: ``x_right = rotation @ x_left + translation_m`` (OpenCV's convention).

    Parameters
    ----------
    image_size
        (columns, rows) of both pictures.
    left, right
        Camera models.
    rotation
        (3, 3) float64, left camera frame to right camera frame.
    translation_m
        (3,) float64, metres; its first component is negative when the right camera stands to the right.
    rms_px
        Reprojection error of the joint calibration, over both pictures; None when the geometry was given.
    vertical_rms_px
        Difference of rows of corresponding corners after rectification (RMS over all used views).
    held_out_vertical_rms_px
        The same on views left out of the calibration (cross-validation); the more honest figure.
    coverage
        Part of the 8 x 6 cells of the picture that hold at least one corner, (left, right).
    board
        The chessboard; None when the geometry was given.
    views
        All views, used or not.
    poses
        How many different poses of the board the used views show; None when the geometry was given.
    working_distance_m
        Distance at which depth and the difference of half-sets are judged.
    distortion
        Which distortion model was chosen, and the scores of all candidates (see `distortion.Score`).
    half_set
        Difference of two calibrations made from every other view (see `differences.Difference`).
    uncertainty
        Standard uncertainties (see `uncertainty.bootstrap`), plain values; None while they are not known.
    corners
        Corners of all views in which both cameras saw the board, by name: ``left`` and ``right`` in pixels, and
        ``points``, which points of the board they are.
    counts_per_kelvin
        Response of the cameras, with which contrast becomes kelvin; None while it is not known.
    temperatures_k
        Mean temperature of the focal plane of the left and the right camera; None while they are not known.
    serials
        Serial numbers of the left and the right camera; None while they are not known.
    source
        Where the views came from.
    created
        ISO 8601, UTC.
    version
        Version of the format; a record that was read keeps its own, and with it its hash.
    """

    image_size: tuple[int, int]
    left: CameraModel
    right: CameraModel
    rotation: Float
    translation_m: Float
    rms_px: float | None = None
    vertical_rms_px: float | None = None
    held_out_vertical_rms_px: float | None = None
    coverage: tuple[float, float] | None = None
    board: Board | None = None
    views: tuple[ViewReport, ...] = ()
    poses: int | None = None
    working_distance_m: float | None = None
    distortion: Mapping[str, Any] | None = None
    half_set: Mapping[str, Any] | None = None
    uncertainty: Mapping[str, Any] | None = None
    corners: Mapping[str, Any] | None = None
    counts_per_kelvin: float | None = None
    temperatures_k: tuple[float, float] | None = None
    serials: tuple[str, str] | None = None
    source: str = ""
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    version: int = VERSION

    def __post_init__(self) -> None:
        rotation, translation = frozen_array(self.rotation), frozen_array(self.translation_m)
        if min(self.image_size) < 1:
            raise CalibrationError(f"a picture cannot have the size {self.image_size}")
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise CalibrationError("the rotation between the cameras is not a rotation matrix")
        if np.linalg.det(rotation) < 0:
            raise CalibrationError("the rotation between the cameras is a reflection")
        if translation.shape != (3,) or not np.isfinite(translation).all() or not translation.any():
            raise CalibrationError(
                "the translation between the cameras must be 3 finite numbers, not all zero"
            )
        if np.abs(translation).max() > _LARGEST_M:
            raise CalibrationError(f"no two cameras stand {np.abs(translation).max():.3g} m apart")
        object.__setattr__(self, "image_size", (int(self.image_size[0]), int(self.image_size[1])))
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation_m", translation)
        for name in ("distortion", "half_set", "uncertainty", "corners"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, json.loads(json.dumps(dict(values))))

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres."""
        return float(np.linalg.norm(self.translation_m))

    @property
    def sha256(self) -> str:
        """Hash of everything in the record, independent of how its JSON is laid out."""
        return _digest(self._content())

    @classmethod
    def from_rectified(
        cls,
        image_size: tuple[int, int],
        focal_px: float,
        principal_point: tuple[float, float] | None,
        baseline_m: float,
        doffs_px: float = 0.0,
        source: str = "given",
    ) -> StereoCalibration:
        """Make the record of pictures that are rectified already; `rectify` will not resample them.

        Parameters
        ----------
        image_size
            (columns, rows).
        focal_px
            Focal length, pixels.
        principal_point
            (u0, v0) of the left picture, pixels; None: the middle of the picture.
        baseline_m
            Distance between the optical centres, metres.
        doffs_px
            Column of the right principal point minus that of the left one (Middlebury's ``doffs``).
        source
            Where the geometry comes from.

        Raises
        ------
        CalibrationError
            A number is not finite, or not positive where it must be.
        """
        u0, v0 = principal_point or ((image_size[0] - 1) / 2, (image_size[1] - 1) / 2)
        if (
            not np.isfinite([focal_px, u0, v0, baseline_m, doffs_px]).all()
            or focal_px <= 0
            or baseline_m <= 0
        ):
            raise CalibrationError(
                f"focal length ({focal_px} px) and baseline ({baseline_m} m) must be positive and everything finite"
            )
        left, right = (
            CameraModel(np.array([[focal_px, 0, u], [0, focal_px, v0], [0, 0, 1]]), np.zeros(5))
            for u in (u0, u0 + doffs_px)
        )
        translation = np.array([-baseline_m, 0.0, 0.0])
        return cls(image_size, left, right, np.eye(3), translation, source=source)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, with format, version and hash."""
        content = self._content()
        return {**content, "sha256": _digest(content)}

    @classmethod
    def from_dict(cls, values: object) -> StereoCalibration:
        """Rebuild a record from what `to_dict` made.

        Raises
        ------
        CalibrationError
            The values are no calibration record, of another version, or were altered since.
        """
        record = Fields(values, "calibration")
        if record.value("format") != FORMAT:
            raise CalibrationError(
                f"this is no stereo calibration (its format is {record.value('format')!r}, not '{FORMAT}')",
                remedy="Give a file made by `thermacq calibrate` or `thermacq calibration rectified`.",
            )
        if record.integer("version") not in _READABLE:
            raise CalibrationError(
                f"calibration version {record.value('version')!r} is not known; this program reads {VERSION}",
                remedy="Use the program version that wrote it, or calibrate again.",
            )
        calibration = _from_fields(record)
        try:
            is_intact = calibration.to_dict() == values
        except ValueError:
            # A number that is not finite, deep inside.
            is_intact = False
        if not is_intact:
            raise CalibrationError(
                "the calibration was altered after it was made: its content does not match its hash",
                remedy="Use the original file, or calibrate again; records are never edited.",
            )
        return calibration

    def save(self, path: Path) -> None:
        """Write the record as JSON to a new file.

        Raises
        ------
        CalibrationError
            The file exists already or cannot be written.
        """
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        with new_file(path):
            path.write_text(text, encoding="utf-8")

    def standard_uncertainty(self, quantity: str) -> float | None:
        """Standard uncertainty of a quantity of `uncertainty.bootstrap`, None while it is not known."""
        value = ((self.uncertainty or {}).get("standard") or {}).get(quantity)
        return None if value is None else float(value)

    def _content(self) -> dict[str, Any]:
        content = {
            "format": FORMAT,
            "version": self.version,
            "image_size": list(self.image_size),
            "left": camera_dict(self.left),
            "right": camera_dict(self.right),
            "rotation": self.rotation.tolist(),
            "translation_m": self.translation_m.tolist(),
            "baseline_m": self.baseline_m,
            "rms_px": self.rms_px,
            "vertical_rms_px": self.vertical_rms_px,
            "held_out_vertical_rms_px": self.held_out_vertical_rms_px,
            "coverage": None if self.coverage is None else list(self.coverage),
            "board": None if self.board is None else board_dict(self.board),
            "views": [vars(view).copy() for view in self.views],
            "uncertainty": None if self.uncertainty is None else dict(self.uncertainty),
            "serials": None if self.serials is None else list(self.serials),
            "source": self.source,
            "created": self.created,
        }
        return content if self.version == 1 else content | self._since_version_2()

    def _since_version_2(self) -> dict[str, Any]:
        return {
            "poses": self.poses,
            "working_distance_m": self.working_distance_m,
            "distortion": None if self.distortion is None else dict(self.distortion),
            "half_set": None if self.half_set is None else dict(self.half_set),
            "corners": None if self.corners is None else dict(self.corners),
            "counts_per_kelvin": self.counts_per_kelvin,
            "temperatures_k": None if self.temperatures_k is None else list(self.temperatures_k),
        }


def load_calibration(path: Path) -> StereoCalibration:
    """Read a calibration file.

    Raises
    ------
    CalibrationError
        The file is missing, no calibration record, damaged or altered.
    """
    text = read_text(path, "calibration record", _MAX_FILE_BYTES, "Make one with `thermacq calibrate`.")
    try:
        return StereoCalibration.from_dict(parse_json(text))
    except CalibrationError as error:
        raise CalibrationError(f"'{path}': {error.what}", remedy=error.remedy) from None


def _from_fields(record: Fields) -> StereoCalibration:
    board = record.optional_table("board")
    coverage = record.optional_numbers("coverage", (2,))
    temperatures = record.optional_numbers("temperatures_k", (2,))
    columns, rows = record.integers("image_size", 2)
    return StereoCalibration(
        image_size=(columns, rows),
        left=camera_from(record.table("left")),
        right=camera_from(record.table("right")),
        rotation=record.numbers("rotation", (3, 3)),
        translation_m=record.numbers("translation_m", (3,)),
        rms_px=record.optional_number("rms_px"),
        vertical_rms_px=record.optional_number("vertical_rms_px"),
        held_out_vertical_rms_px=record.optional_number("held_out_vertical_rms_px"),
        coverage=None if coverage is None else (float(coverage[0]), float(coverage[1])),
        board=None if board is None else board_from(board),
        views=tuple(view_from(view) for view in record.tables("views")),
        poses=None if record.value("poses") is None else record.integer("poses"),
        working_distance_m=record.optional_number("working_distance_m"),
        distortion=record.optional_mapping("distortion"),
        half_set=record.optional_mapping("half_set"),
        uncertainty=record.optional_mapping("uncertainty"),
        corners=record.optional_mapping("corners"),
        counts_per_kelvin=record.optional_number("counts_per_kelvin"),
        temperatures_k=None if temperatures is None else (float(temperatures[0]), float(temperatures[1])),
        serials=None if record.value("serials") is None else record.text_pair("serials"),
        source=record.text("source"),
        created=record.text("created"),
        version=record.integer("version"),
    )


def _digest(content: dict[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
