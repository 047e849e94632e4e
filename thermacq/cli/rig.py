"""``thermacq rig``: check a rig file against its devices, export its JSON schema."""

from __future__ import annotations

import typer

app = typer.Typer(help="Check a rig file, export its schema.", no_args_is_help=True)


@app.command()
def schema() -> None:
    """Print the JSON schema of the rig file."""
    from thermacq.cli.common import print_json
    from thermacq.rig import Rig

    print_json(Rig.model_json_schema())
