"""The report: one self-contained HTML page about a product."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

__all__ = ["write_report"]


def write_report(
    product: Path,
    output: Path,
    *,
    run: Path | None = None,
    still: Path | None = None,
    calibration: Path | None = None,
    correction_files: Sequence[Path] = (),
    title: str = "",
) -> tuple[str, ...]:
    """Write the report on a product; returns notes on what is missing or needs care.

    Parameters
    ----------
    product, run, still, calibration, correction_files, title
        As in `thermacq.report.collect.collect`.
    output
        HTML file to write; it appears only when it is complete.

    Raises
    ------
    StoreError
        A file that was named is missing or cannot be read, or the page cannot be written.
    """
    from thermacq.errors import StoreError
    from thermacq.report.collect import collect
    from thermacq.report.page import render

    data = collect(
        product, run=run, still=still, calibration=calibration, correction_files=correction_files, title=title
    )
    page = render(data)
    unfinished = output.with_name(output.name + ".part")
    try:
        unfinished.write_text(page, encoding="utf-8")
        unfinished.replace(output)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise StoreError(f"'{output}' cannot be written: {error.strerror}") from None
    return data.notes
