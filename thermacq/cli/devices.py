"""``thermacq plugins`` and ``thermacq devices``: what is installed and what is attached."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from thermacq.cli.common import AsJson, out, print_json


def plugins(as_json: AsJson = False) -> None:
    """List the plugins, with the error of each that could not be used."""
    from rich.markup import escape
    from rich.table import Table

    from thermacq import plugins as loaded

    manager = loaded.plugins()
    offers = {
        "drivers": list(manager.drivers()),
        "matchers": list(manager.matchers()),
        "exporters": list(manager.exporters()),
        "commands": list(manager.commands()),
    }
    if as_json:
        print_json({"plugins": [asdict(status) for status in manager.statuses], **offers})
        return
    table = Table("plugin", "distribution", "state", box=None)
    for status in manager.statuses:
        trouble = f"[red]{escape(status.error)}[/]" if status.error else "in use"
        state = "blocked" if status.blocked else trouble
        table.add_row(escape(status.name), f"{status.distribution} {status.version}", state)
    out.print(table)
    for kind, names in offers.items():
        out.print(f"{kind}: {', '.join(names) or 'none'}")


def devices(as_json: AsJson = False) -> None:
    """List the drivers and the devices that they find attached."""
    from rich.markup import escape
    from rich.table import Table

    from thermacq import plugins as loaded
    from thermacq.transports import RealTransports

    rows: list[dict[str, Any]] = []
    for driver in loaded.plugins().drivers().values():
        found: list[dict[str, Any]] = []
        error = ""
        try:
            found = [asdict(identity) for identity in driver.discover(RealTransports())]
        except Exception as problem:
            error = f"{type(problem).__name__}: {problem}"
        rows.append(
            {
                "driver": driver.name,
                "kind": driver.kind.value,
                "proven_on": driver.evidence.value,
                "summary": driver.summary,
                "found": found,
                "error": error,
            }
        )
    if as_json:
        print_json({"drivers": rows})
        return
    table = Table("driver", "kind", "proven on", "found", "summary", box=None)
    for row in rows:
        names = ", ".join(f"{item['model']} {item['serial']}" for item in row["found"])
        shown = [row["driver"], row["kind"], row["proven_on"], row["error"] or names or "-", row["summary"]]
        table.add_row(*map(escape, shown))
    out.print(table)
