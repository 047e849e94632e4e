"""Read a rig file and refuse, with file and line, what cannot be meant."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from pydantic import ValidationError

from thermacq.devices import DeviceKind, TriggerMode
from thermacq.errors import PluginError, RigError
from thermacq.plugins import Plugins, plugins
from thermacq.rig.model import CameraTable, ProbeTable, Rig, TriggerSourceTable
from thermacq.settings import explain
from thermacq.toml_lines import line_of

_Place: TypeAlias = tuple[str, ...]
DeviceTable: TypeAlias = CameraTable | ProbeTable | TriggerSourceTable

_REMEDY = "Mend these lines; `thermacq rig schema` lists all keys."


def load_rig(path: Path, scene: Path | None = None) -> Rig:
    """Read and check a rig file, the settings of its drivers included.

    Parameters
    ----------
    path
        The rig file.
    scene
        TOML file whose keys replace those of the rig's ``[scene]`` table.

    Raises
    ------
    RigError
        A file is missing, is not TOML, or holds unknown or impossible values.
    """
    text = read_toml_text(path)
    rig = _with_whole_paths(parse_rig(text, str(path)), path)
    check_drivers(rig, plugins(), str(path), text)
    if scene is not None:
        looked_at = parse_toml(read_toml_text(scene), str(scene))
        rig = rig.model_copy(update={"scene": {**rig.scene, **looked_at}})
    return rig


def _with_whole_paths(rig: Rig, path: Path) -> Rig:
    """Correction files as absolute paths: a rig file names them relative to itself."""
    folder = path.absolute().parent
    files = {camera: str(folder / file) for camera, file in rig.correction.files.items()}
    table = rig.correction.model_copy(update={"files": files})
    return rig.model_copy(update={"correction": table})


def read_toml_text(path: Path) -> str:
    """Text of a TOML file; raises `RigError` when it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise RigError(
            f"there is no file '{path}'", remedy="Give the path of a TOML file; examples/ has some."
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"'{path}' cannot be read as text: {error}") from None


def parse_toml(text: str, origin: str) -> dict[str, Any]:
    """TOML text to plain values; raises `RigError` naming the line."""
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RigError(f"{origin} is not valid TOML: {error}") from None


def parse_rig(text: str, origin: str = "rig") -> Rig:
    """Check the text of a rig file, drivers not looked at; `origin` names it in messages."""
    values = parse_toml(text, origin)
    try:
        rig = Rig.model_validate(values)
    except ValidationError as error:
        raise RigError(explain(error, Rig, origin, text), remedy=_REMEDY) from None
    _refuse(_contradictions(rig), origin, text)
    return rig


def devices_of(rig: Rig) -> Iterator[tuple[_Place, DeviceKind, DeviceTable]]:
    """Place in the file, kind and table of every device of a rig."""
    groups: tuple[tuple[str, DeviceKind, Mapping[str, DeviceTable]], ...] = (
        ("cameras", DeviceKind.CAMERA, rig.cameras),
        ("probes", DeviceKind.WAVE_PROBE, rig.probes),
        ("trigger_sources", DeviceKind.TRIGGER_SOURCE, rig.trigger_sources),
    )
    for group, kind, tables in groups:
        for name, table in tables.items():
            yield (group, name), kind, table


def check_drivers(rig: Rig, known: Plugins, origin: str = "rig", text: str = "") -> None:
    """Check that every driver exists and takes its settings.

    Raises
    ------
    RigError
        Names file, line and place, and the nearest right name.
    """
    lines: list[str] = []
    for place, kind, table in devices_of(rig):
        try:
            driver = known.driver(table.driver, kind)
            model = driver.settings()
        except PluginError as error:
            lines.append(_line((*place, "driver"), f"{error.what}. {error.remedy}", origin, text))
            continue
        # A driver is foreign code; a failing one is a fact about this line of the rig.
        except Exception as error:
            message = f"driver '{table.driver}' does not tell its settings: {type(error).__name__}: {error}"
            lines.append(_line((*place, "driver"), message, origin, text))
            continue
        try:
            model.model_validate(table.settings)
        except ValidationError as error:
            lines.append(explain(error, model, origin, text, (*place, "settings")))
    lines += _emulation_mistakes(rig, known, origin, text)
    if lines:
        raise RigError("\n".join(lines), remedy="Mend these lines; `thermacq devices` lists the drivers.")


def _emulation_mistakes(rig: Rig, known: Plugins, origin: str, text: str) -> Iterator[str]:
    """What is wrong in the tables ``[emulation.DEVICE]``."""
    drivers = {place[1]: table.driver for place, _, table in devices_of(rig)}
    emulators = known.emulators() if rig.emulation else {}
    for name, settings in rig.emulation.items():
        place = ("emulation", name)
        if name not in drivers:
            near = difflib.get_close_matches(name, drivers, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            yield _line(place, f"there is no device '{name}' in this rig{hint}", origin, text)
        elif drivers[name] not in emulators:
            yield _line(place, f"driver '{drivers[name]}' has no emulator", origin, text)
        else:
            model = emulators[drivers[name]].settings()
            try:
                model.model_validate(settings)
            except ValidationError as error:
                yield explain(error, model, origin, text, place)


def _contradictions(rig: Rig) -> Iterator[tuple[_Place, str]]:
    """What no single table can know."""
    taken: dict[str, _Place] = {}
    for place, _, _ in devices_of(rig):
        name = place[1]
        if name in taken:
            yield place, f"the name '{name}' is already taken by {'.'.join(taken[name])}"
        taken[name] = place
    for camera in rig.correction.files:
        if camera not in rig.cameras:
            known = ", ".join(rig.cameras)
            yield (
                ("correction", "files", camera),
                f"there is no camera '{camera}' in this rig; it has: {known}",
            )
    for pair, sides in rig.pairs.items():
        for side, camera in (("left", sides.left), ("right", sides.right)):
            if camera not in rig.cameras:
                yield ("pairs", pair, side), f"there is no camera '{camera}' in this rig"
        if sides.left == sides.right:
            yield ("pairs", pair), "its left and its right camera are the same"
    source = rig.trigger.source
    if source and source not in rig.trigger_sources:
        near = difflib.get_close_matches(source, rig.trigger_sources, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        yield ("trigger", "source"), f"there is no trigger source '{source}' in this rig{hint}"
    if rig.trigger.mode is TriggerMode.HARDWARE and not source:
        known = ", ".join(rig.trigger_sources) or "none; add [trigger_sources.NAME]"
        yield ("trigger", "mode"), f"mode 'hardware' needs trigger.source; known sources: {known}"


def _refuse(wrong: Iterable[tuple[_Place, str]], origin: str, text: str) -> None:
    lines = [_line(place, message, origin, text) for place, message in wrong]
    if lines:
        raise RigError("\n".join(lines), remedy=_REMEDY)


def _line(place: _Place, message: str, origin: str, text: str) -> str:
    number = line_of(text, place)
    where = f"{origin}, line {number}" if number else origin
    return f"{where}: {'.'.join(place)}: {message}"
