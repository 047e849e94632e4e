"""Aravis: loading it, looking for cameras, and its errors.

Nothing here or in `thermacq_drivers.gige.link` is loaded before a camera is looked for or opened; the rest
of the driver knows no GObject.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from thermacq.errors import ThermacqError


class AravisMissing(ThermacqError):
    """Aravis or its Python binding is not installed."""

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"Aravis cannot be loaded: {reason}",
            remedy="On Debian and Ubuntu: apt install gir1.2-aravis-0.8 libgirepository1.0-dev "
            "libcairo2-dev pkg-config, then pip install 'thermacq[gige]'.",
        )


class LinkError(Exception):
    """The camera refused something, or (`gone`) does not answer.

    Parameters
    ----------
    what
        What Aravis says.
    gone
        Whether the camera did not answer at all.
    """

    def __init__(self, what: str, gone: bool = False) -> None:
        super().__init__(what)
        self.gone = gone


@dataclass(frozen=True)
class FoundCamera:
    """A camera that answered: how Aravis opens it, and which individual it is."""

    id: str
    vendor: str
    model: str
    serial: str
    address: str = ""
    firmware: str = ""


def load() -> Any:
    """Load Aravis; raises `AravisMissing` with the remedy."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        raise AravisMissing(str(error)) from None
    return Aravis


def list_cameras() -> list[FoundCamera]:
    """Cameras that answer a look-round of about one second, in the order of their serial numbers."""
    aravis = load()
    with asking():
        aravis.update_device_list()
        found = [
            FoundCamera(
                id=aravis.get_device_id(i) or "",
                vendor=aravis.get_device_vendor(i) or "",
                model=aravis.get_device_model(i) or "",
                serial=aravis.get_device_serial_nbr(i) or "",
                address=aravis.get_device_address(i) or "",
            )
            for i in range(aravis.get_n_devices())
        ]
    # A camera that is reached through two network interfaces answers twice.
    individuals = {(camera.vendor, camera.model, camera.serial): camera for camera in found}
    return sorted(individuals.values(), key=lambda camera: (camera.serial, camera.model))


@contextmanager
def asking() -> Iterator[None]:
    """Turn what GLib raises into `LinkError`."""
    from gi.repository import Aravis, GLib

    try:
        yield
    except GLib.Error as error:
        kinds = (Aravis.DeviceError.TIMEOUT, Aravis.DeviceError.NOT_FOUND, Aravis.DeviceError.NOT_CONNECTED)
        gone = any(error.matches(Aravis.device_error_quark(), kind) for kind in kinds)
        raise LinkError(error.message, gone) from None
