"""An emulated USB device under the real pyusb: finding, transfers, the errors of libusb, unplugging."""

from __future__ import annotations

import errno
import threading
import time

import pytest
import usb.core
import usb.util

from thermacq.testing.emulation.faults import FaultSchedule, FaultSettings
from thermacq.testing.emulation.usb import (
    Endpoint,
    Interface,
    UsbDescription,
    UsbPlug,
    UsbStall,
    UsbTimeout,
    through_wire,
)
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import RealClock


class Box:
    """Stores what is written, by control or bulk, and gives it back; streams on endpoint 0x82."""

    def __init__(self, serial="A1"):
        self.description = UsbDescription(
            0x1234,
            0x5678,
            serial,
            "box",
            "maker",
            (
                Interface(0, 0, (Endpoint(0x81), Endpoint(0x01))),
                Interface(1, 0),
                Interface(1, 1, (Endpoint(0x82),)),
            ),
        )
        self.halted = set()
        self.chosen = {}
        self.lives = 0

    def power_up(self):
        self.lives += 1
        self.stored = b""

    def control_in(self, request_type, request, value, index, length):
        if request != 7:
            raise UsbStall
        return self.stored[:length]

    def control_out(self, request_type, request, value, index, data):
        self.stored = data

    def bulk_in(self, endpoint, length, timeout_s, gone):
        if endpoint in self.halted:
            raise UsbStall
        deadline_s = time.monotonic() + timeout_s
        while not self.stored and not gone():
            if time.monotonic() > deadline_s:
                raise UsbTimeout
            time.sleep(0.001)
        data, self.stored = self.stored[:length], self.stored[length:]
        return data

    def bulk_out(self, endpoint, data, timeout_s):
        self.stored += data
        return len(data)

    def clear_halt(self, endpoint):
        self.halted.discard(endpoint)

    def select(self, interface, alternate):
        self.chosen[interface] = alternate


def opened(plug):
    device = usb.core.find(backend=EmulatedTransports(usb=[plug]).usb_backend())
    device.set_configuration()
    return device


def test_it_is_found_by_ids_and_told_apart_by_serial_number():
    plugs = [UsbPlug(Box("A1")), UsbPlug(Box("B2"))]
    backend = EmulatedTransports(usb=plugs).usb_backend()
    found = list(usb.core.find(find_all=True, backend=backend, idVendor=0x1234, idProduct=0x5678))
    assert [device.serial_number for device in found] == ["A1", "B2"]
    assert found[0].product == "box"
    assert found[0].address != found[1].address
    assert usb.core.find(backend=backend, idVendor=0x9999) is None
    plugs[0].unplug()
    assert usb.core.find(backend=backend).serial_number == "B2"


def test_its_descriptors_are_walked_as_pyusb_does():
    device = opened(UsbPlug(Box()))
    settings = [(item.bInterfaceNumber, item.bAlternateSetting) for item in device.get_active_configuration()]
    assert settings == [(0, 0), (1, 0), (1, 1)]
    interface = device.get_active_configuration()[(1, 1)]
    assert [endpoint.bEndpointAddress for endpoint in interface] == [0x82]


def test_control_and_bulk_transfers_pass_both_ways():
    device = opened(UsbPlug(Box()))
    assert device.ctrl_transfer(0x41, 6, 1, 2, b"abc") == 3
    assert device.ctrl_transfer(0xC1, 7, 1, 2, 10).tobytes() == b"abc"
    assert device.write(0x01, b"defg") == 4
    assert device.read(0x81, 5, 100).tobytes() == b"abcde"
    assert device.read(0x81, 64, 100).tobytes() == b"fg"


def test_an_alternate_setting_is_chosen():
    box = Box()
    device = opened(UsbPlug(box))
    device.set_interface_altsetting(1, 1)
    assert box.chosen == {1: 1}


def test_silence_and_stalls_are_the_errors_of_libusb():
    box = Box()
    device = opened(UsbPlug(box))
    with pytest.raises(usb.core.USBTimeoutError) as silence:
        device.read(0x81, 5, 30)
    assert (silence.value.errno, silence.value.backend_error_code) == (errno.ETIMEDOUT, -7)
    with pytest.raises(usb.core.USBError) as refused:
        device.ctrl_transfer(0xC1, 99, 0, 0, 1)
    assert refused.value.errno == errno.EPIPE
    box.halted.add(0x81)
    with pytest.raises(usb.core.USBError):
        device.read(0x81, 5, 30)
    device.clear_halt(0x81)
    device.write(0x01, b"x")
    assert device.read(0x81, 5, 100).tobytes() == b"x"


def test_an_interface_belongs_to_one_host():
    plug = UsbPlug(Box())
    first, second = opened(plug), opened(plug)
    usb.util.claim_interface(first, 0)
    with pytest.raises(usb.core.USBError) as busy:
        usb.util.claim_interface(second, 0)
    assert busy.value.errno == errno.EBUSY
    usb.util.dispose_resources(first)
    usb.util.claim_interface(second, 0)


def test_pulled_while_a_read_waits_and_dead_after_it_is_plugged_in_again():
    plug = UsbPlug(Box())
    device = opened(plug)
    timer = threading.Timer(0.05, plug.unplug, (0.05,))
    timer.start()
    with pytest.raises(usb.core.USBError) as gone:
        device.read(0x81, 5, 3000)
    timer.join()
    assert gone.value.errno == errno.ENODEV
    time.sleep(0.06)
    with pytest.raises(usb.core.USBError) as still_gone:
        device.read(0x81, 5, 30)
    assert still_gone.value.errno == errno.ENODEV
    again = opened(plug)
    again.write(0x01, b"ok")
    assert again.read(0x81, 2, 100).tobytes() == b"ok"
    assert plug.device.lives == 2


def test_a_reset_starts_it_afresh():
    plug = UsbPlug(Box())
    device = opened(plug)
    device.write(0x01, b"old")
    device.reset()
    with pytest.raises(usb.core.USBTimeoutError):
        device.read(0x81, 5, 20)


@pytest.mark.parametrize(
    ("kind", "outcome"), [("stall", UsbStall), ("timeout", UsbTimeout), ("drop", b""), ("short_read", b"abc")]
)
def test_faults_of_the_wire(kind, outcome):
    plug = UsbPlug(Box())
    schedule = FaultSchedule([FaultSettings(kind=kind, at=2)], RealClock())
    assert through_wire(b"abcd", schedule.strike(1), plug) == b"abcd"
    faults = schedule.strike(2)
    if isinstance(outcome, bytes):
        assert through_wire(b"abcd", faults, plug) == outcome
    else:
        with pytest.raises(outcome):
            through_wire(b"abcd", faults, plug)
    assert schedule.strike(3) == []
    assert schedule.injected == {kind: 1}


def test_a_disconnect_of_the_wire_pulls_the_plug():
    plug = UsbPlug(Box())
    through_wire(b"abcd", [FaultSettings(kind="disconnect", at=0)], plug)
    assert not plug.plugged
