"""Validation of the simulator: all checks by topic, and the page of the documentation that shows them.

`thermacq simulate validate -o docs` makes page and pictures anew; nothing on the page is typed by hand but
its text, which is `validation_page.md` beside this module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path

from thermacq_drivers.simflume import validation_cameras as cameras
from thermacq_drivers.simflume import validation_geometry as geometry
from thermacq_drivers.simflume import validation_theory as theory
from thermacq_drivers.simflume import validation_water as water
from thermacq_drivers.simflume.cases import TABLE_II
from thermacq_drivers.simflume.validation_water import Check

Checks = Mapping[str, Sequence[Check]]

TOPICS: dict[str, Callable[[], list[Check]]] = {
    "heights": water.height_checks,
    "dispersion": water.dispersion_checks,
    "profiles": lambda: [theory.profile_check(case) for case in TABLE_II.values()],
    "drift": lambda: [
        *water.drift_checks(),
        *(theory.tracking_check(case) for case in TABLE_II.values()),
    ],
    "seas": lambda: [*water.energy_checks(), *water.reflection_checks(), water.seiche_check()],
    "diffraction": lambda: [*water.wall_checks(), *theory.field_checks()],
    "noise": lambda: [*cameras.noise_checks(), *cameras.flicker_checks()],
    "response": lambda: [
        *cameras.lens_checks(),
        *cameras.lag_checks(),
        cameras.rolling_check(),
        cameras.drift_check(),
    ],
    "rays": lambda: [
        *geometry.projection_checks(),
        *(geometry.ray_check(name) for name in geometry.water_scenes()),
    ],
    "disparity": lambda: [*geometry.warp_checks(), *geometry.occlusion_checks()],
}
"""What is checked, by the names that the page knows."""

PAGE = Path("explanation", "simulator-validation.md")
PICTURES = Path("pictures", "validation")


def run_checks(topics: Iterable[str] = (), tell: Callable[[str], object] = str) -> dict[str, list[Check]]:
    """Checks of some topics, or of all; `tell` is called with the name of each topic before it."""
    found = {}
    for topic in topics or TOPICS:
        tell(topic)
        found[topic] = TOPICS[topic]()
    return found


def write_page(checks: Checks, folder: Path) -> list[Path]:
    """Write the page and its pictures below a folder laid out like `docs`; returns what was written."""
    from thermacq_drivers.simflume.validation_plots import draw_all

    page = folder / PAGE
    page.parent.mkdir(parents=True, exist_ok=True)
    pictures = draw_all(checks, folder / PICTURES)
    page.write_text(page_text(checks), encoding="utf-8")
    return [page, *pictures]


def page_text(checks: Checks) -> str:
    """The page: its text, with the table of each topic where the text wants it."""
    text = resources.files(__package__).joinpath("validation_page.md").read_text(encoding="utf-8")
    every = [check for some in checks.values() for check in some]
    held = sum(check.holds for check in every)
    text = text.replace("{summary}", f"{held} of {len(every)} checks hold.")
    for topic, some in checks.items():
        text = text.replace(f"{{table {topic}}}", "\n".join(table_lines(some)))
    return text


def table_lines(checks: Iterable[Check]) -> list[str]:
    """Checks as a Markdown table."""
    lines = ["| check | known | found | tolerance | holds |", "|---|--:|--:|--:|---|"]
    for check in checks:
        # A bar would end the cell; numbers too small to mean anything differ from machine to machine.
        name = check.name.replace("|", "\\|")
        found = "< 1e-9" if abs(check.found) < 1e-9 else f"{check.found:.5g}"
        unit = "" if check.unit in {"", "1"} else f" {check.unit}"
        holds = "yes" if check.holds else "**no**"
        lines.append(
            f"| {name} | {check.known:.5g}{unit} | {found}{unit} | {check.tolerance:.2g}{unit} | {holds} |"
        )
    return lines
