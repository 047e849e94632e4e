"""Run every benchmark, or those named: ``python -m benchmarks [NAME ...]``.

Each module of this folder has ``run()``, which returns rows: name, value, unit, baseline, ratio. A ratio
is always measured in one run against the named baseline, so that it means something on a slow machine.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

HERE = Path(__file__).parent
RESULTS = HERE / "results"


def main() -> None:
    """Run the benchmarks and print their rows; keep them as JSON under benchmarks/results."""
    known = sorted(path.stem for path in HERE.glob("*.py") if not path.stem.startswith("_"))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"which benchmarks; all of: {', '.join(known)}")
    names = parser.parse_args().names or known
    if unknown := sorted(set(names) - set(known)):
        parser.error(f"unknown: {', '.join(unknown)}; known: {', '.join(known)}")
    console = Console()
    results = {}
    for name in names:
        console.print(f"[bold]{name}[/] ...")
        rows = importlib.import_module(f"benchmarks.{name}").run()
        results[name] = rows
        table = Table("what", "value", "unit", "baseline", "ratio", box=None)
        for row in rows:
            ratio = "" if row.get("ratio") is None else f"{row['ratio']:.3g}"
            table.add_row(row["name"], f"{row['value']:.4g}", row["unit"], row.get("baseline") or "", ratio)
        console.print(table)
    RESULTS.mkdir(exist_ok=True)
    machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
    path = RESULTS / time.strftime("%Y%m%dT%H%M%S.json", time.gmtime())
    path.write_text(json.dumps({"machine": machine, "results": results}, indent=2))
    console.print(f"written to {path}")


if __name__ == "__main__":
    main()
