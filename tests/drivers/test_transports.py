"""What drivers share: serial and USB access with typed faults, on emulated ports and devices."""

from __future__ import annotations

import threading
import time

import pytest

from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.testing.emulation.pty import PtyPort
from thermacq.testing.emulation.usb import Endpoint, Interface, UsbDescription, UsbPlug, UsbStall, UsbTimeout
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import RealClock
from thermacq.transports import SerialNode
from thermacq_drivers.transports.serial import SerialPort, find_port
from thermacq_drivers.transports.usb import UsbPort, UsbStalled, find_devices

NODES = [SerialNode("/dev/ttyACM0", 1, 2, "A"), SerialNode("/dev/ttyACM1", 1, 2, "B")]


class Talker:
    """Answers each byte by itself and a line end."""

    def power_up(self):
        pass

    def receive(self, data):
        return [bytes([byte]) + b"\r\n" for byte in data]

    def due_ns(self):
        return None

    def act(self):
        return ()


@pytest.fixture
def cable():
    with PtyPort(Talker(), SerialNode("", 1, 2, "S"), RealClock()) as cable:
        yield cable


@pytest.fixture
def port(cable):
    port = SerialPort("gauge", cable.node().path)
    yield port
    port.close()


def test_a_port_is_chosen_by_serial_number_or_path():
    assert find_port(NODES, "gauge", serial="B").path == "/dev/ttyACM1"
    assert find_port(NODES, "gauge", path="/dev/ttyACM0").serial == "A"
    assert find_port(NODES[:1], "gauge").serial == "A"


def test_no_port_and_several_ports_are_told():
    with pytest.raises(DeviceDisconnected, match="'C' was not found; attached: A, B"):
        find_port(NODES, "gauge", serial="C")
    with pytest.raises(DeviceDisconnected, match="attached: none"):
        find_port([], "gauge")
    with pytest.raises(DeviceFault, match="several devices fit: A, B"):
        find_port(NODES, "gauge")


def test_reads_are_exact_and_bounded(port):
    port.write(b"ab", "acquire")
    assert port.read(4, 1.0, "acquire") == b"a\r\nb"
    assert port.read_some(0.2, "acquire") == b"\r\n"
    assert port.read_some(0.01, "acquire") == b""
    start_s = time.monotonic()
    with pytest.raises(DeviceTimeout, match=r"0 of 3 bytes came within 0.1 s"):
        port.read(3, 0.1, "acquire")
    assert time.monotonic() - start_s < 20.0


def test_a_wait_ends_when_the_host_stops(port):
    stop = threading.Event()
    threading.Timer(0.05, stop.set).start()
    assert port.read(3, 30.0, "acquire", stop.is_set) == b""


def test_a_pulled_port_is_a_typed_fault_in_every_verb(cable, port):
    cable.unplug()
    for action in (
        lambda: port.read(1, 0.5, "acquire"),
        lambda: port.read_some(0.1, "acquire"),
        lambda: port.write(b"a", "acquire"),
        lambda: port.check("acquire"),
        lambda: port.discard("acquire"),
    ):
        with pytest.raises(DeviceDisconnected, match=r"device 'gauge' \(acquire\): the port .* is gone"):
            action()
    port.close()


def test_a_port_that_another_program_has_is_refused(cable, port):
    with pytest.raises(DeviceFault, match="may not be opened") as refused:
        SerialPort("other", cable.node().path)
    assert "Another program" in refused.value.remedy


def test_a_port_that_is_not_there_is_disconnected():
    with pytest.raises(DeviceDisconnected):
        SerialPort("gauge", "/dev/does-not-exist")


class Store:
    """Gives back what was written; stalls on request 9."""

    def __init__(self, serial):
        self.description = UsbDescription(
            5, 6, serial, interfaces=(Interface(0, 0, (Endpoint(0x81), Endpoint(0x01))),)
        )
        self.stored = b""

    def power_up(self):
        self.stored = b""

    def control_in(self, request_type, request, value, index, length):
        if request == 9:
            raise UsbStall
        return self.stored[:length]

    def control_out(self, request_type, request, value, index, data):
        self.stored = data

    def bulk_in(self, endpoint, length, timeout_s, gone):
        if not self.stored:
            raise UsbTimeout
        return self.stored[:length]

    def bulk_out(self, endpoint, data, timeout_s):
        self.stored = data
        return len(data)

    def clear_halt(self, endpoint):
        pass

    def select(self, interface, alternate):
        pass


@pytest.fixture
def plug():
    return UsbPlug(Store("A"))


def usb_port(*plugs, serial=""):
    return UsbPort("camera", EmulatedTransports(usb=plugs), [(5, 6)], serial)


def test_a_usb_device_is_chosen_by_serial_number(plug):
    other = UsbPlug(Store("B"))
    assert usb_port(plug, other, serial="B").serial == "B"
    assert len(find_devices(EmulatedTransports(usb=[plug, other]), [(5, 6)])) == 2
    assert find_devices(EmulatedTransports(usb=[plug]), [(5, 7)]) == []
    with pytest.raises(DeviceFault, match="several devices fit: A, B"):
        usb_port(plug, other)
    with pytest.raises(DeviceDisconnected, match="no device with serial 'C'; attached: A"):
        usb_port(plug, serial="C")


def test_usb_transfers_pass(plug):
    port = usb_port(plug)
    port.control_out(0x41, 1, 0, 0, b"hello", "configure")
    assert port.control_in(0xC1, 1, 0, 0, 3, "configure") == b"hel"
    assert port.bulk_write(0x01, b"bulk", 0.1, "acquire") == 4
    assert port.bulk_read(0x81, 512, 0.1, "acquire") == b"bulk"
    port.close()


def test_usb_faults_are_typed(plug):
    port = usb_port(plug)
    with pytest.raises(DeviceTimeout):
        port.bulk_read(0x81, 512, 0.05, "acquire")
    with pytest.raises(UsbStalled):
        port.control_in(0xC1, 9, 0, 0, 1, "configure")
    with pytest.raises(DeviceFault, match="another program uses it"):
        usb_port(plug)
    plug.unplug()
    with pytest.raises(DeviceDisconnected, match=r"device 'camera' \(acquire\): it is gone from USB"):
        port.bulk_read(0x81, 512, 0.05, "acquire")
    port.close()
    plug.plug()
    assert usb_port(plug).serial == "A"
