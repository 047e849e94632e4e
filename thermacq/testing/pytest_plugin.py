"""Options of the conformance suite; pytest loads this wherever thermacq is installed, so it is light."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--driver``, ``--driver-settings`` and ``--real-device``."""
    group = parser.getgroup("thermacq", "conformance of thermacq drivers")
    group.addoption("--driver", metavar="NAME", help="driver that `thermacq.testing.conformance` checks")
    group.addoption(
        "--driver-settings", metavar="FILE", help="TOML file with the settings to check the driver with"
    )
    group.addoption(
        "--real-device",
        action="store_true",
        help="check the driver on the attached device, although there is an emulator",
    )
