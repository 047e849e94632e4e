"""Matcher ``sgbm``: OpenCV's semi-global matching, made fit for thermal water, then refined.

Raw 16-bit counts are freed of shading, stretched to 8 bits by percentiles common to both pictures, matched,
and refined to sub-pixel precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from thermacq_plugins.refinement import Picture, refine

_MODES = {
    "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
    "hh": cv2.STEREO_SGBM_MODE_HH,
}
_SUBPIXEL = 16


class SgbmSettings(BaseModel):
    """Settings of semi-global matching."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    min_disparity: int | None = Field(
        None, ge=-2048, le=2048, description="pixels, may be negative; unset: found from the run, else 0"
    )
    max_disparity: int | None = Field(
        None, ge=-2048, le=2048, description="pixels; unset: found from the run, else a quarter of the width"
    )
    mode: Literal["3way", "sgbm", "hh"] = Field("3way", description="3, 5 or 8 directions")
    block_size: int = Field(9, ge=1, le=21, description="pixels, odd")
    uniqueness_percent: int = Field(10, ge=0, le=100)
    left_right_px: int = Field(1, ge=-1, description="largest left-right difference; -1: no check")
    speckle_size_px: int = Field(100, ge=0, description="smaller islands are dropped; 0: none")
    speckle_range_px: int = Field(2, ge=1)
    stretch_percent: float = Field(0.5, ge=0, lt=50, description="share clipped at either end of the stretch")
    shading_degree: int = Field(3, ge=0, le=6, description="of the smooth surface taken out beforehand")
    presmooth_px: float = Field(1.0, ge=0, le=10, description="Gaussian against noise before matching")
    refine: bool = Field(True, description="refine to sub-pixel precision")
    refine_sigma_px: float = Field(10.0, ge=2, le=50, description="Gaussian window of the refinement")
    min_correlation: float = Field(0.35, ge=-1, le=1, description="of the refined windows, else NaN")

    @model_validator(mode="after")
    def _check(self) -> SgbmSettings:
        if self.block_size % 2 == 0:
            message = "block_size must be odd"
            raise ValueError(message)
        if (
            self.min_disparity is not None
            and self.max_disparity is not None
            and self.max_disparity <= self.min_disparity
        ):
            message = "max_disparity must be greater than min_disparity"
            raise ValueError(message)
        return self


class SgbmMatcher:
    """Semi-global matching with refinement."""

    def __init__(self, settings: SgbmSettings) -> None:
        self._settings = settings

    def match(self, left: NDArray[np.float32], right: NDArray[np.float32]) -> NDArray[np.float32]:
        """Disparity of the left picture; see `thermacq.hooks.DisparityMatcher`."""
        settings = self._settings
        left, right = (take_out_shading(picture, settings.shading_degree) for picture in (left, right))
        disparity = self._semi_global(*_to_8_bit((left, right), settings))
        disparity[~(np.isfinite(left) & _matched_pixel_known(right, disparity))] = np.nan
        if not settings.refine:
            return disparity
        return refine(left, right, disparity, settings.refine_sigma_px, settings.min_correlation)

    def _semi_global(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Picture:
        """Disparity in steps of 1/16 px; NaN where OpenCV found none or it points outside the picture."""
        settings = self._settings
        columns = left.shape[1]
        lowest = 0 if settings.min_disparity is None else settings.min_disparity
        highest = lowest + columns // 4 if settings.max_disparity is None else settings.max_disparity
        count = 16 * max(1, -(-(highest - lowest + 1) // 16))
        # OpenCV gives no disparity to columns whose search would leave the picture; a margin brings back
        # those whose match is still inside.
        before, after = max(0, lowest + count), max(0, -lowest)
        padded = [
            cv2.copyMakeBorder(picture, 0, 0, before, after, cv2.BORDER_REPLICATE)
            for picture in (left, right)
        ]
        block_area = settings.block_size**2
        matcher = cv2.StereoSGBM.create(
            minDisparity=lowest,
            numDisparities=count,
            blockSize=settings.block_size,
            P1=8 * block_area,
            P2=32 * block_area,
            disp12MaxDiff=settings.left_right_px,
            preFilterCap=31,
            uniquenessRatio=settings.uniqueness_percent,
            speckleWindowSize=settings.speckle_size_px,
            speckleRange=settings.speckle_range_px,
            mode=_MODES[settings.mode],
        )
        found = matcher.compute(*padded)[:, before : before + columns]
        disparity = np.asarray(found / np.float32(_SUBPIXEL), np.float32)
        disparity[(found < _SUBPIXEL * lowest) | (disparity > highest + 1)] = np.nan
        matched = np.arange(columns, dtype=np.float32) - disparity
        disparity[(matched < 0) | (matched > columns - 1)] = np.nan
        return disparity


def take_out_shading(picture: Picture, degree: int) -> Picture:
    """Take the low-order surface of best fit (the lamps' gradient, shading) out of a picture; keeps NaN.

    Parameters
    ----------
    picture
        (rows, columns) float32, NaN outside.
    degree
        Highest total degree of the polynomial; 0 takes out the mean.
    """
    rows, columns = picture.shape
    y, x = (np.polynomial.legendre.legvander(np.linspace(-1, 1, n), degree) for n in (rows, columns))
    thin = slice(None, None, 8)
    sample = picture[thin, thin]
    valid = np.isfinite(sample)
    if not valid.any():
        return picture
    terms = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    design = np.stack([np.multiply.outer(y[thin, i], x[thin, j])[valid] for i, j in terms], axis=1)
    weights = np.zeros((degree + 1, degree + 1))
    # The normal equations of orthogonal polynomials are well-conditioned, and a hundred times quicker.
    normal = design.T @ design + 1e-6 * np.eye(len(terms))
    weights[tuple(zip(*terms, strict=True))] = np.linalg.solve(normal, design.T @ sample[valid])
    surface = (y @ weights @ x.T).astype(np.float32)
    return np.asarray(picture - surface, np.float32)


def _to_8_bit(pictures: Sequence[Picture], settings: SgbmSettings) -> list[NDArray[np.uint8]]:
    """Pictures to 8 bits by common percentiles; NaN pixels become mid-grey."""
    # A zero keeps percentiles defined for pictures without a valid pixel.
    sample = np.concatenate([*(picture[np.isfinite(picture)][::7] for picture in pictures), np.zeros(1)])
    low, high = np.percentile(sample, (settings.stretch_percent, 100.0 - settings.stretch_percent))
    scale = np.float32(255.0 / max(float(high - low), 1e-6))
    grey = []
    for picture in pictures:
        filled = np.where(np.isfinite(picture), picture, np.float32(0.5 * (low + high)))
        if settings.presmooth_px:
            filled = np.asarray(cv2.GaussianBlur(filled, (0, 0), settings.presmooth_px))
        grey.append(((filled - np.float32(low)) * scale).clip(0, 255).astype(np.uint8))
    return grey


def _matched_pixel_known(right: Picture, disparity: Picture) -> NDArray[np.bool_]:
    """Whether the pixel of the right picture that each disparity points to is a picture at all."""
    known = np.isfinite(disparity)
    columns = np.arange(right.shape[1]) - np.where(known, np.rint(np.nan_to_num(disparity)), 0)
    matched = np.take_along_axis(
        np.isfinite(right), columns.astype(np.intp).clip(0, right.shape[1] - 1), axis=1
    )
    result: NDArray[np.bool_] = known & matched
    return result
