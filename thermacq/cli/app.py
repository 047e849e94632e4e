"""All commands, and `main`, which runs one and turns errors into messages.

Each command lives in a module of this package and imports what it needs when it runs, so that
``thermacq --help`` stays quick.
"""

from __future__ import annotations

import sys

import typer

from thermacq.cli import (
    calibrate,
    calibration,
    common,
    correction,
    demo,
    devices,
    doctor,
    evaluation,
    noise,
    preheat,
    reconstruction,
    recording,
    rig,
    store,
    world,
)
from thermacq.cli.plugin_commands import GroupWithPlugins

app = typer.Typer(
    name="thermacq",
    cls=GroupWithPlugins,
    help="Measure water waves without touching them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("demo")(demo.demo)
app.command("plugins")(devices.plugins)
app.command("devices")(devices.devices)
app.command("doctor")(doctor.doctor)
app.add_typer(rig.app, name="rig")
app.command("record")(recording.record)
app.command("status")(recording.status)
app.command("stop")(recording.stop)
app.command("info")(store.info)
app.command("verify")(store.verify)
app.command("recover")(store.recover)
app.command("import")(store.import_)
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(calibration.app, name="calibration")
app.add_typer(correction.app, name="correction")
app.command("preheat")(preheat.preheat)
app.command("noise")(noise.noise)
app.command("still-water")(reconstruction.still_water)
app.command("reconstruct")(reconstruction.reconstruct)
app.add_typer(world.app, name="world")
app.command("fuse")(world.fuse)
app.command("disparity")(reconstruction.disparity)
app.command("waves")(evaluation.waves)
app.command("compare")(evaluation.compare)
app.command("report")(evaluation.report)
app.command("export")(evaluation.export)


@app.callback()
def _root() -> None:
    """Measure water waves without touching them."""


def main() -> None:
    """Entry point of the ``thermacq`` command.

    Errors that carry ``what`` (`ThermacqError`, and the errors of ``thermacq_calibration``, which knows
    nothing of ours) and those of the file system are explained; anything else is a bug and is traced.
    """
    try:
        app()
    except Exception as error:
        if not (hasattr(error, "what") or isinstance(error, OSError)):
            raise
        common.show_error(error)
        sys.exit(common.EXIT_FAILED)
