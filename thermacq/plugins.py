"""The plugin manager: loads every plugin behind a guard and answers who offers what.

A plugin that fails to import, or that registers an unknown hook, is listed with its error and never stops
the program. ``THERMACQ_PLUGINS_ALLOW`` and ``THERMACQ_PLUGINS_BLOCK`` (comma-separated entry-point names)
choose which plugins are loaded.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, TypeVar, cast

import pluggy

from thermacq import hooks
from thermacq.devices import DeviceKind
from thermacq.errors import PluginError, ThermacqError
from thermacq.hooks import (
    Command,
    CorrectionStage,
    Driver,
    Emulator,
    Exporter,
    Matcher,
    RigFinding,
    Truth,
    TruthRequest,
)

if TYPE_CHECKING:
    from thermacq.rig import Rig

ALLOW_VARIABLE = "THERMACQ_PLUGINS_ALLOW"
BLOCK_VARIABLE = "THERMACQ_PLUGINS_BLOCK"

_Named = TypeVar("_Named", Driver, Emulator, CorrectionStage, Matcher, Exporter, Command)


@dataclass(frozen=True)
class PluginStatus:
    """How the loading of one plugin went; `error` is empty when it is in use."""

    name: str
    distribution: str
    version: str
    module: str
    blocked: bool
    error: str


class Plugins:
    """All plugins of this process."""

    def __init__(self, found: Iterable[EntryPoint], allow: frozenset[str], block: frozenset[str]) -> None:
        self._manager = pluggy.PluginManager(hooks.GROUP)
        self._manager.add_hookspecs(hooks)
        self.statuses: list[PluginStatus] = []
        self._errors: dict[str, str] = {}
        for entry in sorted(found, key=lambda entry: entry.name):
            blocked = entry.name in block or bool(allow and entry.name not in allow)
            error = "" if blocked else self._load(entry)
            distribution = entry.dist
            self.statuses.append(
                PluginStatus(
                    name=entry.name,
                    distribution=distribution.name if distribution else "",
                    version=distribution.version if distribution else "",
                    module=entry.value,
                    blocked=blocked,
                    error=error,
                )
            )

    def _load(self, entry: EntryPoint) -> str:
        """Load and register one plugin; return what went wrong."""
        registered = None
        try:
            plugin = entry.load()
            registered = self._manager.register(plugin, name=entry.name)
            self._manager.check_pending()
        except KeyboardInterrupt:
            raise
        # A plugin is foreign code: whatever it raises, even SystemExit at import, must not stop the host.
        except BaseException as error:
            if registered is not None:
                self._manager.unregister(name=registered)
            return f"{type(error).__name__}: {error}"
        return ""

    def _offers(self, hook: str) -> list[tuple[str, object]]:
        """Call one hook on each plugin by itself, so that a failing one does not hide the others."""
        offers: list[tuple[str, object]] = []
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            try:
                offers.extend((implementation.plugin_name, item) for item in implementation.function())
            except Exception as error:
                self._note_error(implementation.plugin_name, f"{hook}: {type(error).__name__}: {error}")
        return offers

    def _note_error(self, plugin: str, error: str) -> None:
        self.statuses = [
            PluginStatus(**{**vars(status), "error": error}) if status.name == plugin else status
            for status in self.statuses
        ]

    def _by_name(self, hook: str, kind: type[_Named]) -> dict[str, _Named]:
        found: dict[str, _Named] = {}
        for plugin, item in self._offers(hook):
            if not isinstance(item, kind):
                self._note_error(plugin, f"{hook} returned a {type(item).__name__}, not a {kind.__name__}")
            elif item.name in found:
                self._note_error(plugin, f"{hook}: the name '{item.name}' is taken by another plugin")
            else:
                found[item.name] = item
        return dict(sorted(found.items()))

    def drivers(self, kind: DeviceKind | None = None) -> dict[str, Driver]:
        """All drivers by name, or those of one kind."""
        drivers = self._by_name("thermacq_drivers", Driver)
        return {name: driver for name, driver in drivers.items() if kind in (None, driver.kind)}

    def driver(self, name: str, kind: DeviceKind | None = None) -> Driver:
        """One driver.

        Raises
        ------
        PluginError
            There is no such driver of that kind; the message names the nearest.
        """
        return _pick(self.drivers(kind), name, f"{kind.value.replace('_', ' ') if kind else 'device'} driver")

    def emulators(self) -> dict[str, Emulator]:
        """All emulators by the name of the driver that they serve."""
        return self._by_name("thermacq_emulators", Emulator)

    def emulator(self, driver: str) -> Emulator:
        """The emulator of a driver's device; raises `PluginError` like `driver`."""
        return _pick(self.emulators(), driver, "emulator for a driver")

    def correction_stages(self) -> dict[str, CorrectionStage]:
        """All correction stages by name."""
        return self._by_name("thermacq_correction_stages", CorrectionStage)

    def correction_stage(self, name: str) -> CorrectionStage:
        """One correction stage; raises `PluginError` like `driver`."""
        return _pick(self.correction_stages(), name, "correction stage")

    def matchers(self) -> dict[str, Matcher]:
        """All matchers by name."""
        return self._by_name("thermacq_matchers", Matcher)

    def matcher(self, name: str) -> Matcher:
        """One matcher; raises `PluginError` like `driver`."""
        return _pick(self.matchers(), name, "matcher")

    def exporters(self) -> dict[str, Exporter]:
        """All exporters by name."""
        return self._by_name("thermacq_exporters", Exporter)

    def exporter(self, name: str) -> Exporter:
        """One exporter; raises `PluginError` like `driver`."""
        return _pick(self.exporters(), name, "exporter")

    def commands(self) -> dict[str, Command]:
        """Command groups that plugins add."""
        return self._by_name("thermacq_commands", Command)

    def rig_checks(self, rig: Rig) -> list[RigFinding]:
        """What the plugins find wrong with a rig."""
        findings: list[RigFinding] = []
        for implementation in self._manager.hook.thermacq_rig_checks.get_hookimpls():
            try:
                found = cast("Sequence[RigFinding]", implementation.function(rig))
                findings.extend(RigFinding(finding.severity, finding.message) for finding in found)
            except Exception as error:
                message = f"rig check of plugin '{implementation.plugin_name}' failed: {error}"
                findings.append(RigFinding("warning", message))
        return findings

    def truth(self, request: TruthRequest) -> Truth | None:
        """Truth of a simulated scene, None when no plugin simulated it.

        Raises
        ------
        PluginError
            The plugin that simulated the scene failed.
        """
        try:
            truth: Truth | None = self._manager.hook.thermacq_truth(request=request)
        except ThermacqError:
            raise
        except Exception as error:
            raise PluginError(
                f"a plugin failed to give the truth: {type(error).__name__}: {error}"
            ) from error
        return truth


def _pick(offered: dict[str, _Named], name: str, what: str) -> _Named:
    if name in offered:
        return offered[name]
    near = difflib.get_close_matches(name, offered, n=1)
    hint = f"Did you mean '{near[0]}'? " if near else ""
    raise PluginError(
        f"there is no {what} named '{name}'",
        remedy=f"{hint}Known: {', '.join(offered) or 'none'}. `thermacq plugins` shows what was loaded.",
    )


def _names(variable: str) -> frozenset[str]:
    return frozenset(filter(None, (name.strip() for name in os.environ.get(variable, "").split(","))))


def load_plugins(found: Sequence[EntryPoint] | None = None) -> Plugins:
    """Load the plugins of this installation (or the given entry points)."""
    entries = entry_points(group=hooks.GROUP) if found is None else found
    return Plugins(entries, _names(ALLOW_VARIABLE), _names(BLOCK_VARIABLE))


@cache
def plugins() -> Plugins:
    """The plugins of this process, loaded once."""
    return load_plugins()
