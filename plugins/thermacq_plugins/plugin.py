"""Entry point of the built-in matchers and exporters; imports nothing heavy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from thermacq.hooks import DisparityMatcher, Exporter, Matcher, hookimpl

if TYPE_CHECKING:
    from pydantic import BaseModel

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


def _write_ply(product: Path, output: Path, frame: int) -> None:
    from thermacq_plugins.exporters import write_ply

    write_ply(product, output, frame)


def _write_vts(product: Path, output: Path, frame: int) -> None:
    from thermacq_plugins.exporters import write_vts

    write_vts(product, output, frame)


def _write_csv(product: Path, output: Path, frame: int) -> None:
    from thermacq_plugins.exporters import write_csv

    write_csv(product, output, frame)
