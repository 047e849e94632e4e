"""Command groups that plugins add: looked up only when help is asked for or a name is not our own."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from thermacq.cli.common import warn


class GroupWithPlugins(TyperGroup):
    """Our own commands first; a broken plugin costs a warning, never our own commands."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands."""
        own = super().list_commands(ctx)
        return [*own, *(name for name in _offered() if name not in own)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Find one command; None when there is none, or its plugin is broken."""
        own = super().get_command(ctx, cmd_name)
        return own if own is not None else _make(cmd_name)


def _offered() -> dict[str, Any]:
    from thermacq.plugins import plugins

    return dict(plugins().commands())


def _make(name: str) -> Any:
    command = _offered().get(name)
    if command is None:
        return None
    try:
        app = command.make()
        # Help looks the same for all commands.
        app.rich_markup_mode = None
        made = typer.main.get_command(app)
        made.name = name
    except KeyboardInterrupt:
        raise
    # Foreign code: whatever it raises must not take our own commands along.
    except BaseException as error:
        warn(f"command '{name}' of a plugin cannot be used: {type(error).__name__}: {error}")
        return None
    return made
