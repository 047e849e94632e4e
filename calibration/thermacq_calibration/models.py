"""The parts of a calibration record: camera model, target, and the report on one view."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.fields import Fields

Float: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Pinhole camera with lens distortion, OpenCV's model and order of coefficients.

    Parameters
    ----------
    matrix
        (3, 3) float64, pixels: focal lengths and principal point.
    distortion
        (4 | 5 | 8 | 12 | 14,) float64: k1, k2, p1, p2, k3, ...
    rms_px
        Reprojection error (RMS over corners, both axes together) of this camera calibrated alone; None
        when the model was given, not measured.
    """

    matrix: Float
    distortion: Float
    rms_px: float | None = None

    def __post_init__(self) -> None:
        matrix, distortion = frozen_array(self.matrix), frozen_array(self.distortion)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or min(matrix[0, 0], matrix[1, 1]) <= 0:
            raise CalibrationError("a camera matrix must be 3 x 3, finite, with positive focal lengths")
        if not np.array_equal(matrix[2], (0, 0, 1)) or matrix[1, 0] != 0:
            raise CalibrationError("a camera matrix must be upper triangular with last row 0 0 1")
        if (
            distortion.ndim != 1
            or distortion.size not in {4, 5, 8, 12, 14}
            or not np.isfinite(distortion).all()
        ):
            raise CalibrationError("distortion must be 4, 5, 8, 12 or 14 finite coefficients")
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion)


class BoardKind(StrEnum):
    """What a target looks like."""

    CHESSBOARD = "chessboard"
    CIRCLES = "circles"
    """Asymmetric grid of circles."""
    CHARUCO = "charuco"
    """Chessboard with an ArUco marker in every bright square."""
    MARKED = "marked"
    """Chessboard with one large ArUco marker in its middle, which hides some corners."""


@dataclass(frozen=True)
class Board:
    """A flat target, most often a chessboard.

    Parameters
    ----------
    columns, rows
        Inner corners along and across; of circles: how many in a row, and how many rows.
    square_m
        Side of a square, metres; of circles: distance of rows, which is half the distance within a row.
    kind
        What the target looks like.
    marker_m
        Side of the black border of its marker(s), metres; 0 without markers.
    dictionary
        OpenCV's name of the dictionary of its marker(s), e.g. ``DICT_4X4_50``; empty without markers.
    """

    columns: int
    rows: int
    square_m: float
    kind: BoardKind = BoardKind.CHESSBOARD
    marker_m: float = 0.0
    dictionary: str = ""


@dataclass(frozen=True)
class ViewReport:
    """One pose of the board: whether it was used, and what was measured on it.

    Parameters
    ----------
    name
        Name of the view: the key that its two pictures share, or its frames.
    used
        Whether it took part in the calibration.
    reason
        Why it did not, in words; empty when it did.
    left_rms_px, right_rms_px
        Reprojection error in each picture under the joint calibration.
    vertical_rms_px
        Difference of rows of corresponding corners after rectification (RMS).
    held_out_vertical_rms_px
        The same under a calibration made without this view.
    tilt_deg
        Angle between the normal of the board and the left optical axis.
    distance_m
        Distance of the middle of the board from the left camera.
    sharpness_px
        Width of the edges of squares (10 % to 90 %), the worse of the two pictures.
    contrast
        Difference between light and dark squares in counts, the lower of the two pictures.
    """

    name: str
    used: bool
    reason: str = ""
    left_rms_px: float | None = None
    right_rms_px: float | None = None
    vertical_rms_px: float | None = None
    held_out_vertical_rms_px: float | None = None
    tilt_deg: float | None = None
    distance_m: float | None = None
    sharpness_px: float | None = None
    contrast: float | None = None


def board_from(board: Fields) -> Board:
    """Board of a parsed record; records of plain chessboards do not name the kind."""
    plain = Board(board.integer("columns"), board.integer("rows"), board.number("square_m"))
    if board.value("kind") is None:
        return plain
    try:
        kind = BoardKind(board.text("kind"))
    except ValueError:
        raise CalibrationError(f"boards of kind '{board.text('kind')}' are not known") from None
    return replace(plain, kind=kind, marker_m=board.number("marker_m"), dictionary=board.text("dictionary"))


def board_dict(board: Board) -> dict[str, Any]:
    """Plain values of a board; a plain chessboard has no other keys than it always had, so hashes last."""
    values = {"columns": board.columns, "rows": board.rows, "square_m": board.square_m}
    if board.kind is BoardKind.CHESSBOARD:
        return values
    return {**values, "kind": board.kind.value, "marker_m": board.marker_m, "dictionary": board.dictionary}


def camera_from(camera: Fields) -> CameraModel:
    """Camera model of a parsed record."""
    return CameraModel(
        camera.numbers("matrix", (3, 3)),
        camera.numbers("distortion", (-1,)),
        camera.optional_number("rms_px"),
    )


def view_from(view: Fields) -> ViewReport:
    """View report of a parsed record."""
    return ViewReport(
        name=view.text("name"),
        used=view.flag("used"),
        reason=view.text("reason"),
        left_rms_px=view.optional_number("left_rms_px"),
        right_rms_px=view.optional_number("right_rms_px"),
        vertical_rms_px=view.optional_number("vertical_rms_px"),
        held_out_vertical_rms_px=view.optional_number("held_out_vertical_rms_px"),
        tilt_deg=view.optional_number("tilt_deg"),
        distance_m=view.optional_number("distance_m"),
        sharpness_px=view.optional_number("sharpness_px"),
        contrast=view.optional_number("contrast"),
    )


def camera_dict(camera: CameraModel) -> dict[str, Any]:
    """Plain values of a camera model."""
    return {
        "matrix": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        "rms_px": camera.rms_px,
    }


def frozen_array(values: Float) -> Float:
    """Copy that cannot be written to; raises `CalibrationError` when something is no number."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise CalibrationError("a calibration holds something that is not a number") from None
    array.flags.writeable = False
    return array
