"""Entry point of the built-in matchers, correction stages and exporters; imports nothing heavy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from thermacq.hooks import (
    CorrectionStage,
    DisparityMatcher,
    Exporter,
    Matcher,
    PictureCorrection,
    hookimpl,
)

if TYPE_CHECKING:
    from pydantic import BaseModel

    from thermacq_plugins.destriping import DestripingSettings
    from thermacq_plugins.sgbm import SgbmSettings


@hookimpl
def thermacq_matchers() -> Sequence[Matcher]:
    """Built-in matchers."""
    return [
        Matcher(
            name="sgbm",
            summary="OpenCV's semi-global matching, refined to hundredths of a pixel on smooth surfaces",
            settings=_sgbm_settings,
            make=_make_sgbm,
        )
    ]


@hookimpl
def thermacq_correction_stages() -> Sequence[CorrectionStage]:
    """Built-in further corrections of pictures; none is on unless it is named."""
    return [
        CorrectionStage(
            name="destriping",
            summary="column noise as offsets, at high spatial frequency, learnt while the scene moves",
            settings=_destriping_settings,
            make=_make_destriping,
            memory=_destriping_memory,
        )
    ]


@hookimpl
def thermacq_exporters() -> Sequence[Exporter]:
    """Built-in export formats."""
    return [
        Exporter("ply", "point cloud of one frame, coloured by elevation", ".ply", _write_ply),
        Exporter("vtk", "surface of one frame for ParaView (XML structured grid)", ".vts", _write_vts),
        Exporter("csv", "cells of one frame as text", ".csv", _write_csv),
    ]


def _sgbm_settings() -> type[BaseModel]:
    from thermacq_plugins.sgbm import SgbmSettings

    return SgbmSettings


def _make_sgbm(settings: BaseModel) -> DisparityMatcher:
    from thermacq_plugins.sgbm import SgbmMatcher

    return SgbmMatcher(cast("SgbmSettings", settings))


def _destriping_settings() -> type[BaseModel]:
    from thermacq_plugins.destriping import DestripingSettings

    return DestripingSettings


def _make_destriping(settings: BaseModel) -> PictureCorrection:
    from thermacq_plugins.destriping import Destriping

    return Destriping(cast("DestripingSettings", settings))


def _destriping_memory(settings: BaseModel) -> int:
    return cast("DestripingSettings", settings).memory_pictures


def _write_ply(product: Path, output: Path, frame: int) -> None:
    from thermacq_plugins.exporters import write_ply

    write_ply(product, output, frame)


def _write_vts(product: Path, output: Path, frame: int) -> None:
    from thermacq_plugins.exporters import write_vts

    write_vts(product, output, frame)


def _write_csv(product: Path, output: Path, frame: int) -> None:
    from thermacq_plugins.exporters import write_csv

    write_csv(product, output, frame)
