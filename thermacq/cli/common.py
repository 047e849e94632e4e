"""What the commands share: consoles, options, JSON output, and the way errors are shown."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any

import typer
from rich.console import Console

# Options and arguments that several commands have.
AsJson = Annotated[bool, typer.Option("--json", help="Machine-readable output.")]
UNIFORM_VIEW = "RUN[@KELVIN[@A:B]]"
"""How a uniform view in a run is written, see `thermacq.imaging.references.parse_reference`."""

EXIT_FAILED = 1
EXIT_FINDINGS = 3
EXIT_INTERRUPTED = 130

out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


def print_json(value: Any) -> None:
    """Data for programs: one JSON document on stdout."""
    json.dump(value, sys.stdout, indent=2, default=_json_value)
    sys.stdout.write("\n")


def _json_value(value: Any) -> Any:
    return sorted(value) if isinstance(value, frozenset) else str(value)


def show_error(error: Exception) -> None:
    """Show an error to a person: what happened first, then what was kept and what to do."""
    what, kept, remedy = (getattr(error, name, "") for name in ("what", "kept", "remedy"))
    err.print(f"[bold red]error:[/] {_escape(what or str(error))}")
    for line in (kept, remedy):
        if line:
            err.print(f"  {_escape(line)}")


def warn(text: str) -> None:
    """Tell a person of something that did not stop the command."""
    err.print(f"[bold yellow]warning:[/] {_escape(text)}")


def _escape(text: str) -> str:
    from rich.markup import escape

    return escape(text)
