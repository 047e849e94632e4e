"""The LabJack U6 as a wave probe: volts of its analogue inputs, and ticks of the cameras' trigger pulses."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import (
    DeviceContext,
    DeviceIdentity,
    ProbeCapabilities,
    SampleBlock,
    Settings,
    StreamHost,
)
from thermacq.errors import DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.settings import check_settings
from thermacq_drivers.labjack_u6 import codec
from thermacq_drivers.labjack_u6.link import Link, find
from thermacq_drivers.labjack_u6.settings import U6Settings
from thermacq_drivers.labjack_u6.stream import RECOVERED, EdgeFinder, Packet, PacketParser, Run, ScanAssembler
from thermacq_drivers.transports.usb import UsbStalled

_log = logging.getLogger(__name__)
_WAIT_S = 0.05
_FULL_PACKET = 25
_PACKET_S = 0.05
_READ_S = 0.02
_MOST_PACKETS = 64
# Error codes of packets after which the samples can still be used.
_GOOD_CODES = (0, 59, RECOVERED)
_SCAN_OVERLAP = 55


class LabJackU6:
    """The wave probe behind ``driver = "labjack_u6"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._serial = context.serial
        self._settings = U6Settings()
        self._calibration = codec.NOMINAL
        self._link: Link | None = None
        self._configured = self._armed = self._streaming = False
        self._restart()

    def _restart(self) -> None:
        settings = self._settings
        samples_per_s = settings.rate_hz * settings.channels
        self._scan_clock = codec.scan_clock(settings.rate_hz)
        # Whole scans at low rates, full packets (which can be read several at a time) at higher ones.
        self._per_packet = min(_FULL_PACKET, max(settings.channels, int(samples_per_s * _PACKET_S)))
        packets = 1
        if self._per_packet == _FULL_PACKET:
            packets = min(_MOST_PACKETS, max(1, int(samples_per_s * _READ_S) // _FULL_PACKET))
        self._read_bytes = packets * codec.PACKET_BYTES
        self._parser = PacketParser(self._per_packet)
        self._assembler = ScanAssembler(settings.channels, self._per_packet)
        self._edges = EdgeFinder(max(0, settings.line))
        self._pulses = np.empty(0, np.int64)
        self._damaged = 0
        self._last_scan = -1
        self._waiting: list[Packet] = []

    @property
    def capabilities(self) -> ProbeCapabilities:
        """Its inputs in volts, and the clock of its stream."""
        return ProbeCapabilities(
            channels=tuple(item.name for item in self._settings.inputs),
            unit="V",
            max_sample_rate_hz=self._settings.fastest_hz,
            tick_rate_hz=self._scan_clock.tick_rate_hz,
            has_trigger_line=self._settings.line >= 0,
        )

    def open(self) -> DeviceIdentity:
        """Find the device by the serial number that the rig expects, or that it had before."""
        self.close()
        self._link, individual = find(self._name, self._transports, self._serial)
        self._serial = individual.serial
        return DeviceIdentity("labjack_u6", individual.model, individual.serial, individual.firmware)

    def configure(self, settings: Settings) -> Settings:
        """Apply settings; ``rate_hz`` and ``calibration`` come back as they are really in force."""
        self.disarm()
        link = self._require_link("configure")
        self._configured = False
        checked = check_settings(U6Settings, settings, self._name)
        rate_hz = codec.scan_clock(checked.rate_hz).rate_hz
        self._settings = checked.model_copy(update={"rate_hz": rate_hz})
        if checked.calibration == "device":
            self._read_calibration(link)
        else:
            self._calibration = codec.NOMINAL
        self._restart()
        self._send_stream_config(link)
        self._configured = True
        return self._settings.model_dump(mode="json")

    def _read_calibration(self, link: Link) -> None:
        """Constants of this device; nominal ones, said so in the settings, when it holds none."""
        try:
            self._calibration = codec.calibration_from(link.calibration_blocks())
        except ValueError as error:
            _log.warning("device '%s': nominal calibration is used: %s", self._name, error)
            self._calibration = codec.NOMINAL
            self._settings = self._settings.model_copy(update={"calibration": "nominal"})

    def _send_stream_config(self, link: Link) -> None:
        settings = self._settings
        inputs = [codec.Input(item.ain, item.gain, item.differential) for item in settings.inputs]
        if settings.line >= 0:
            inputs.append(codec.Input(codec.DIGITAL_CHANNEL))
        command = codec.stream_config(
            inputs, self._scan_clock, self._per_packet, settings.resolution, settings.settling
        )
        try:
            error = link.configure_stream(command)
        except ValueError as damage:
            raise self._fault("configure", str(damage)) from None
        if error:
            raise self._fault(
                "configure",
                f"it refused these settings of its stream: error {error}",
                "A lower rate, resolution or settling may do.",
            )

    def arm(self) -> None:
        """Get ready; the stream starts with the first call of `samples`, and scans count from there."""
        self.disarm()
        self._require_link("arm")
        if not self._configured:
            raise self._fault("arm", "it is not configured")
        self._restart()
        self._armed = True

    def samples(self, host: StreamHost) -> Iterator[SampleBlock]:
        """Yield scans as they come.

        After a damaged packet (`IncompleteFrame`) or scans that the device dropped because the host was late
        (`DeviceOverrun`) the stream goes on; ``first_index`` jumps by what was lost.
        """
        link = self._require_armed()
        if not self._streaming:
            self._start(link)
        heard_s = time.monotonic()
        while self._armed and not host.stopping():
            packets, self._waiting = self._waiting or self._read(link), []
            if packets:
                heard_s = time.monotonic()
            elif time.monotonic() - heard_s > self._settings.timeout_s:
                what = f"no packet within {self._settings.timeout_s:g} s"
                raise DeviceTimeout(self._name, "acquire", what, last_frame=self._last_scan)
            runs: list[Run] = []
            while packets and not packets[0].dropped:
                runs += self._scans(packets.pop(0))
            yield from self._blocks(runs)
            if packets:
                self._waiting = packets[1:]
                yield from self._blocks(self._scans(packets[0]))
                self._tell_dropped(packets[0].dropped)
            self._tell_damage()

    def _start(self, link: Link) -> None:
        try:
            error = link.start_stream()
        except ValueError as damage:
            raise self._fault("acquire", str(damage)) from None
        if error:
            raise self._fault("acquire", f"it did not start its stream: error {error}")
        self._streaming = True

    def _read(self, link: Link) -> list[Packet]:
        try:
            return self._parser.feed(link.read_stream(self._read_bytes, _WAIT_S))
        except UsbStalled:
            link.clear_stream()
            raise self._incomplete("the stream halted (stall)") from None
        except DeviceTimeout:
            return []

    def _scans(self, packet: Packet) -> list[Run]:
        if packet.error not in _GOOD_CODES:
            what, remedy = f"its stream failed: error {packet.error}", "Unplug it and plug it in again."
            if packet.error == _SCAN_OVERLAP:
                what = "a scan began before the one before had ended (error 55)"
                remedy = "Lower `rate_hz`, `resolution` or `settling`, or use fewer inputs."
            raise self._fault("acquire", what, remedy)
        try:
            return self._assembler.take(packet)
        except ValueError as error:
            raise self._fault("acquire", str(error), "Record again.") from None

    def _blocks(self, runs: list[Run]) -> Iterator[SampleBlock]:
        """One block for all scans that follow each other, so that its last one was received when it was taken."""
        while runs:
            first_scan, codes = runs.pop(0)
            parts = [codes]
            following = first_scan + len(codes)
            while runs and runs[0][0] == following:
                parts.append(runs.pop(0)[1])
                following += len(parts[-1])
            yield self._block(first_scan, np.concatenate(parts))

    def _block(self, first_scan: int, codes: NDArray[np.uint16]) -> SampleBlock:
        settings, interval = self._settings, self._scan_clock.interval
        inputs = enumerate(settings.inputs)
        values = np.stack(
            [self._calibration.volts(codes[:, place], item.gain) for place, item in inputs], axis=1
        )
        pulses = np.empty(0, np.int64)
        if settings.line >= 0:
            # The line rose between two scans.
            pulses = self._edges.take(first_scan, codes[:, -1]) * interval - interval // 2
        ticks = (first_scan + np.arange(len(codes), dtype=np.int64)) * interval
        self._last_scan = first_scan + len(codes) - 1
        return SampleBlock(values, ticks, first_scan, self._clock.now_ns(), pulses)

    def _tell_dropped(self, scans: int) -> None:
        what = f"the host was late: the device dropped {scans} scans"
        raise DeviceOverrun(self._name, "acquire", what, last_frame=self._last_scan)

    def _tell_damage(self) -> None:
        new, self._damaged = self._parser.damaged - self._damaged, self._parser.damaged
        if new > 0:
            raise self._incomplete(f"{new} packets arrived damaged")

    def _incomplete(self, what: str) -> IncompleteFrame:
        return IncompleteFrame(self._name, "acquire", what, last_frame=self._last_scan)

    def disarm(self) -> None:
        """End the stream."""
        self._armed = False
        if self._streaming and self._link is not None:
            with suppress(DeviceFault):
                self._link.stop_stream("disarm")
        self._streaming = False

    def close(self) -> None:
        """Let go of the device."""
        self.disarm()
        self._configured = False
        if self._link is not None:
            self._link.close()
            self._link = None

    def _require_armed(self) -> Link:
        if not self._armed:
            raise self._fault("acquire", "it is not armed")
        return self._require_link("acquire")

    def _require_link(self, stage: str) -> Link:
        if self._link is None:
            raise self._fault(stage, "it is not open")
        return self._link

    def _fault(self, stage: str, what: str, remedy: str = "") -> DeviceFault:
        return DeviceFault(self._name, stage, what, last_frame=self._last_scan, remedy=remedy)
