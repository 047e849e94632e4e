"""A serial port with deadlines and typed faults, over pyserial.

Every wait is bounded. What the operating system says when a cable is pulled differs from port to port; here
it always becomes `DeviceDisconnected`, and silence always becomes `DeviceTimeout`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.transports import SerialNode

if TYPE_CHECKING:
    import serial

    from thermacq.devices import DeviceContext

# Reads return this often, so that whoever waits can look whether to stop.
_SLICE_S = 0.05


def find_port(nodes: Sequence[SerialNode], device: str, *, serial: str = "", path: str = "") -> SerialNode:
    """Choose the port of a device among those that exist.

    Parameters
    ----------
    nodes
        Candidates, e.g. those with the right USB ids.
    device
        Name of the device in the rig, for messages.
    serial, path
        What the rig says; empty accepts any, if there is only one.

    Raises
    ------
    DeviceDisconnected
        There is none, or no such one.
    DeviceFault
        There are several and nothing says which.
    """
    fitting = [node for node in nodes if serial in ("", node.serial) and path in ("", node.path)]
    wanted = serial or path
    if not fitting:
        seen = ", ".join(node.serial or node.path for node in nodes) or "none"
        what = f"serial port of '{wanted}' was not found" if wanted else "its serial port was not found"
        raise DeviceDisconnected(
            device,
            "open",
            f"{what}; attached: {seen}",
            remedy="Check power and cable; `thermacq devices` lists what is attached.",
        )
    if len(fitting) > 1:
        seen = ", ".join(node.serial or node.path for node in fitting)
        raise DeviceFault(
            device,
            "open",
            f"several devices fit: {seen}",
            remedy="Say in the rig which one is meant: its serial, or its port where it has none.",
        )
    return fitting[0]


class PortFinder:
    """Finds the serial port of one device, and the same device again after its cable was pulled; holds it open.

    Parameters
    ----------
    context
        Context of the device: its name, where to look, which serial number the rig expects, and the setting
        ``port`` for devices without one.
    ids
        (vid, pid) that are taken; empty takes any. A named port is taken whatever its ids.
    """

    def __init__(self, context: DeviceContext, ids: Sequence[tuple[int, int]] = ()) -> None:
        self._name, self._transports, self._ids = context.name, context.transports, ids
        self._serial, self._path = context.serial, str(context.settings.get("port", ""))
        self.node: SerialNode | None = None
        self._open: SerialPort | None = None

    def find(self) -> SerialNode:
        """Look for it; raises as `find_port` does."""
        nodes = self._transports.serial_ports()
        if self._ids and not self._path:
            nodes = [node for node in nodes if (node.vid, node.pid) in self._ids]
        self.node = find_port(nodes, self._name, serial=self._serial, path=self._path)
        self._serial = self._serial or self.node.serial
        return self.node

    def confirm(self, port: str) -> SerialNode:
        """The port that was found, if it is the one that the settings name (empty: any); for `configure`."""
        if self.node is None:
            raise DeviceFault(self._name, "configure", "it is not open")
        if port not in ("", self.node.path):
            what = f"settings name port '{port}', the open one is '{self.node.path}'"
            raise DeviceFault(self._name, "configure", what)
        return self.node

    def connect(self, port: str, baud: int, frame: str = "8N1") -> SerialPort:
        """Open the port that was found, anew if it is open; as `confirm`, for `configure`."""
        node = self.confirm(port)
        self._let_go()
        self._open = SerialPort(self._name, node.path, baud, frame)
        return self._open

    def port(self, stage: str) -> SerialPort:
        """The port that `connect` opened; raises `DeviceFault` before that."""
        if self._open is None:
            raise DeviceFault(self._name, stage, "it is not open and configured")
        return self._open

    def close(self) -> None:
        """Close the port and forget where it was; never raises."""
        self._let_go()
        self.node = None

    def _let_go(self) -> None:
        if self._open is not None:
            self._open.close()
            self._open = None


class SerialPort:
    """An open serial port of one device.

    Parameters
    ----------
    device
        Name of the device in the rig, for faults.
    path
        Path of the port.
    baud
        Symbols per second; without meaning for a virtual port over USB.
    frame
        Data bits, parity and stop bits, such as ``8N1``.
    """

    def __init__(self, device: str, path: str, baud: int = 115_200, frame: str = "8N1") -> None:
        import serial

        self._device = device
        self.path = path
        self._port: serial.Serial
        with self._faults("open"):
            self._port = serial.Serial(
                path,
                baud,
                bytesize=int(frame[0]),
                parity=frame[1],
                stopbits=int(frame[2]),
                timeout=_SLICE_S,
                write_timeout=1.0,
                exclusive=True,
            )

    def write(self, data: bytes, stage: str) -> None:
        """Send bytes; raises `DeviceDisconnected`, or `DeviceTimeout` when the device takes none."""
        with self._faults(stage):
            self._port.write(data)

    def read(
        self, number: int, timeout_s: float, stage: str, stopping: Callable[[], bool] = lambda: False
    ) -> bytes:
        """Read exactly so many bytes; fewer only when `stopping`.

        Raises
        ------
        DeviceTimeout
            They did not come in time; the message says how many did.
        DeviceDisconnected
            The port is gone.
        """
        deadline_s = time.monotonic() + timeout_s
        data = b""
        while len(data) < number and not stopping():
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                what = f"{len(data)} of {number} bytes came within {timeout_s:g} s"
                raise DeviceTimeout(self._device, stage, what)
            with self._faults(stage):
                self._port.timeout = min(left_s, _SLICE_S)
                data += self._port.read(number - len(data))
        return data

    def read_some(self, timeout_s: float, stage: str) -> bytes:
        """Whatever has arrived, waiting for the first byte up to the timeout; empty when none came."""
        with self._faults(stage):
            waiting = self._port.in_waiting
            if not waiting:
                self._port.timeout = timeout_s
                return bytes(self._port.read(1)) + bytes(self._port.read(self._port.in_waiting or 0))
            return bytes(self._port.read(waiting))

    def check(self, stage: str) -> None:
        """Raise `DeviceDisconnected` when the port is gone; reads nothing."""
        with self._faults(stage):
            _ = self._port.in_waiting

    def discard(self, stage: str) -> None:
        """Forget what has arrived and was not read, e.g. answers to another program."""
        with self._faults(stage):
            self._port.reset_input_buffer()

    def close(self) -> None:
        """Close; never raises, for the port may be gone."""
        with suppress(Exception):
            self._port.close()

    @contextmanager
    def _faults(self, stage: str) -> Iterator[None]:
        """Turn what pyserial and the operating system raise into the typed faults."""
        import termios

        import serial

        try:
            yield
        except serial.SerialTimeoutException:
            raise DeviceTimeout(self._device, stage, f"it takes no bytes on {self.path}") from None
        except PermissionError as error:
            raise self._refused(stage, error) from None
        except (OSError, termios.error, TypeError) as error:
            # pyserial of a pulled port raises SerialException, OSError, or TypeError from a closed descriptor.
            if isinstance(error, serial.SerialException) and error.errno in (13, 16, 11):
                raise self._refused(stage, error) from None
            what = f"the port {self.path} is gone"
            raise DeviceDisconnected(
                self._device, stage, what, remedy="Check power and cable, then try again."
            ) from None

    def _refused(self, stage: str, error: OSError) -> DeviceFault:
        remedy = (
            "Let the user join the group that owns the port (dialout), then log in again."
            if error.errno == 13
            else "Another program has it open; close that one."
        )
        return DeviceFault(self._device, stage, f"the port {self.path} may not be opened", remedy=remedy)
