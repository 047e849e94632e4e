"""The camera behind ``driver = "gige"``: finding it again, its settings, its trigger modes, its end."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from thermacq.devices import (
    CameraCapabilities,
    DeviceContext,
    DeviceIdentity,
    Frame,
    FrameHost,
    Settings,
    TriggerMode,
)
from thermacq.errors import DeviceDisconnected, DeviceFault
from thermacq.settings import check_settings
from thermacq_drivers.gige.acquisition import GONE_REMEDY, Acquisition
from thermacq_drivers.gige.aravis import AravisMissing, FoundCamera, LinkError, list_cameras
from thermacq_drivers.gige.link import AravisLink
from thermacq_drivers.gige.settings import BIT_DEPTHS, GigeSettings

NS_PER_S = 1e9
SOFTWARE_SOURCE = "Software"
# Rate that is accepted of a camera that tells none.
_UNKNOWN_RATE_HZ = 1000.0
_RATE_TOLERANCE = 0.02
_PARTING_S = 15.0
_PTP_POLL_S = 0.25
_PTP_LOCKED = ("Slave", "Master")
_NOT_OPEN = CameraCapabilities(0, 0, 0, 0.0, frozenset())


def identity_of(found: FoundCamera) -> DeviceIdentity:
    """Identity of a camera; its address or port plays no part in it."""
    model = f"{found.vendor} {found.model}".strip()
    return DeviceIdentity("gige", model or "GenICam camera", found.serial or found.id, found.firmware)


class GigeCamera:
    """Any camera that Aravis can drive."""

    def __init__(self, context: DeviceContext) -> None:
        self._context = context
        self._name = context.name
        self._settings = GigeSettings()
        self._serial = context.serial or str(context.settings.get("serial", ""))
        self._address = str(context.settings.get("address", ""))
        self._link: AravisLink | None = None
        self._capabilities = _NOT_OPEN
        self._acquisition: Acquisition | None = None
        self._parting: threading.Thread | None = None

    @property
    def capabilities(self) -> CameraCapabilities:
        """What the camera declares with the settings in force; nothing before it is open."""
        return self._capabilities

    def open(self) -> DeviceIdentity:
        """Connect to the camera that the rig means; after a loss, to the same one again."""
        self.close()
        self._finish_parting()
        try:
            with self._during("open"):
                self._link = AravisLink(self._address or self._choose().id)
                about = self._link.about()
                self._capabilities = self._declare(self._link)
        except AravisMissing as missing:
            raise self._fault(DeviceFault, "open", missing.what, missing.remedy) from None
        except DeviceFault:
            self.close()
            raise
        identity = identity_of(about)
        if self._serial and identity.serial != self._serial:
            self.close()
            what = f"the camera at {self._address} has serial '{identity.serial}', not '{self._serial}'"
            raise self._fault(DeviceFault, "open", what, "Mend address or serial in the rig file.")
        self._serial = identity.serial
        return identity

    def configure(self, settings: Settings) -> Settings:
        """Apply settings and return what the camera answered."""
        wanted = check_settings(GigeSettings, settings, self._name)
        self.disarm()
        if wanted.serial and wanted.serial != self._serial:
            what = f"settings ask for serial '{wanted.serial}', the open camera is '{self._serial}'"
            raise self._fault(DeviceFault, "configure", what, "Name the serial before the camera is opened.")
        link = self._opened("configure")
        with self._during("configure"):
            self._settings = _apply(link, wanted)
            self._capabilities = self._declare(link)
        return self._settings.model_dump()

    def adopt(self) -> Settings:
        """Read what is in force on the camera; buffers and time limits, which are the host's, stay as they were."""
        link, settings = self._opened("adopt"), self._settings
        with self._during("adopt"):
            pixel_format = str(link.get("PixelFormat"))
            if pixel_format not in BIT_DEPTHS:
                known = ", ".join(BIT_DEPTHS)
                raise self._fault(DeviceFault, "adopt", f"it sends {pixel_format}; possible are {known}")
            settings = settings.model_copy(
                update={
                    "pixel_format": pixel_format,
                    "packet_size": link.packet_size() or settings.packet_size,
                }
            )
            self._settings = _in_force(link, settings, link.set_exposure_us(0.0))
            self._capabilities = self._declare(link)
        return self._settings.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Set the trigger, prepare the stream; a free-running camera starts with the first frame asked for."""
        self.disarm()
        link, declared, settings = self._opened("arm"), self.capabilities, self._settings
        if mode not in declared.trigger_modes:
            what = f"it cannot run in mode '{mode}' (trigger line '{settings.trigger_line}')"
            raise self._fault(DeviceFault, "arm", what)
        if not 0 < frame_rate_hz <= declared.max_frame_rate_hz:
            what = f"{frame_rate_hz:g} frames/s asked, at most {declared.max_frame_rate_hz:g} possible"
            raise self._fault(DeviceFault, "arm", what)
        patience_s = settings.timeout_s
        with self._during("arm"):
            if settings.ptp:
                self._wait_for_ptp(link)
            link.set_trigger("")
            if mode is TriggerMode.FREE_RUN:
                self._set_frame_rate(link, frame_rate_hz)
                patience_s = max(patience_s, 2 / frame_rate_hz)
            else:
                link.set_trigger(SOFTWARE_SOURCE if mode is TriggerMode.SOFTWARE else settings.trigger_line)
            link.prepare_stream(settings)
            acquisition = Acquisition(self._name, link, settings, mode, patience_s, self._context.clock)
            if mode is not TriggerMode.FREE_RUN:
                acquisition.start()
        self._acquisition = acquisition

    def trigger(self, index: int) -> None:
        """Expose now; returns within a millisecond, or after 2.5 s when the camera does not answer."""
        if self._acquisition is None or not self._acquisition.is_software:
            raise self._fault(DeviceFault, "trigger", "it is not armed for software triggers")
        with self._during("trigger"):
            self._acquisition.trigger(index)

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Yield pictures in the host's buffers."""
        if self._acquisition is None:
            return
        with self._during("acquire"):
            yield from self._acquisition.frames(host)

    def disarm(self) -> None:
        """Stop; of a camera that is lost nothing is asked any more."""
        acquisition, self._acquisition = self._acquisition, None
        if acquisition is None:
            return
        acquisition.end()
        link = self._link
        if link is not None and not link.lost:
            with suppress(LinkError):
                link.stop()
        if link is not None and not link.lost:
            link.drop_stream()

    def close(self) -> None:
        """Let go of the camera."""
        self.disarm()
        link, self._link = self._link, None
        self._capabilities = _NOT_OPEN
        if link is None:
            return
        if not link.lost:
            link.drop()
            return
        # Aravis tries for about 5 s to say good-bye to a camera that is gone; nobody has to wait for it
        # but whoever opens the camera again.
        self._finish_parting()
        self._parting = threading.Thread(target=link.drop, name=f"parting from {self._name}")
        self._parting.start()

    def _choose(self) -> FoundCamera:
        """Choose among the cameras that answer: the one with the serial, or the only one."""
        found = list_cameras()
        listed = ", ".join(f"{camera.model} {identity_of(camera).serial}" for camera in found) or "none"
        matching = [one for one in found if self._serial in ("", identity_of(one).serial)]
        if not matching:
            wanted = f"no camera with serial '{self._serial}'" if self._serial else "no camera"
            raise self._fault(
                DeviceDisconnected,
                "open",
                f"{wanted} answers (found: {listed})",
                "Check power, cable and network; a camera in another network needs settings.address.",
            )
        if len(matching) > 1:
            what = f"several cameras answer: {listed}"
            raise self._fault(DeviceFault, "open", what, "Say which with serial in the rig file.")
        return matching[0]

    def _declare(self, link: AravisLink) -> CameraCapabilities:
        settings = self._settings
        _, _, columns, rows = link.region()
        sources = link.trigger_sources()
        modes = {TriggerMode.FREE_RUN}
        if SOFTWARE_SOURCE in sources:
            modes.add(TriggerMode.SOFTWARE)
        if settings.trigger_line in sources:
            modes.add(TriggerMode.HARDWARE)
        limits_hz = [rate for rate in (link.max_frame_rate_hz(), settings.max_frame_rate_hz) if rate > 0]
        return CameraCapabilities(
            rows=rows,
            columns=columns,
            bit_depth=BIT_DEPTHS[settings.pixel_format],
            max_frame_rate_hz=min(limits_hz, default=_UNKNOWN_RATE_HZ),
            trigger_modes=frozenset(modes),
            tick_rate_hz=NS_PER_S,
            # The ids of the frames wrap at 16 bits; the driver hands them on continuously.
            counter_bits=64,
        )

    def _set_frame_rate(self, link: AravisLink, frame_rate_hz: float) -> None:
        """Keep the rate or refuse it; the rate of a camera that cannot be asked is what the settings say."""
        applied_hz = link.set_frame_rate(frame_rate_hz) or self._settings.max_frame_rate_hz
        if abs(applied_hz / frame_rate_hz - 1) > _RATE_TOLERANCE:
            if applied_hz == 0:
                remedy = "Say at which rate it runs with max_frame_rate_hz, and ask for that rate."
                raise self._fault(DeviceFault, "arm", "its frame rate cannot be set", remedy)
            what = f"{frame_rate_hz:g} frames/s asked, it runs at {applied_hz:g}"
            raise self._fault(DeviceFault, "arm", what)

    def _wait_for_ptp(self, link: AravisLink) -> None:
        deadline_s = time.monotonic() + self._settings.ptp_wait_s
        while (status := link.ptp_status()) not in _PTP_LOCKED:
            if time.monotonic() > deadline_s:
                raise self._fault(
                    DeviceFault,
                    "arm",
                    f"PTP is in state '{status}' after {self._settings.ptp_wait_s:g} s, not in step",
                    "Check that a PTP master runs in this network, or set ptp = false.",
                )
            time.sleep(_PTP_POLL_S)

    def _finish_parting(self) -> None:
        if self._parting is not None:
            self._parting.join(_PARTING_S)
            self._parting = None

    def _opened(self, stage: str) -> AravisLink:
        if self._link is None:
            raise self._fault(DeviceFault, stage, "it is not open")
        return self._link

    @contextmanager
    def _during(self, stage: str) -> Iterator[None]:
        """Turn what Aravis says into the typed fault of this device."""
        try:
            yield
        except LinkError as error:
            if error.gone:
                raise self._fault(DeviceDisconnected, stage, f"no answer: {error}", GONE_REMEDY) from None
            raise self._fault(DeviceFault, stage, str(error)) from None

    def _fault(self, kind: type[DeviceFault], stage: str, what: str, remedy: str = "") -> DeviceFault:
        return kind(self._name, stage, what, remedy=remedy)


def _apply(link: AravisLink, wanted: GigeSettings) -> GigeSettings:
    """Set everything and return what is in force."""
    link.set_trigger("")
    for name, value in wanted.features.items():
        link.set(name, value)
    link.set_pixel_format(wanted.pixel_format)
    link.set_region(wanted.offset_x, wanted.offset_y, wanted.columns, wanted.rows)
    exposure_us = link.set_exposure_us(wanted.exposure_us)
    packet_size = link.set_packet_size(wanted.packet_size)
    granted = link.prepare_stream(wanted)
    link.drop_stream()
    if wanted.ptp:
        link.enable_ptp()
    changed = {"packet_size": packet_size, "socket_buffer_bytes": granted}
    return _in_force(link, wanted.model_copy(update=changed), exposure_us)


def _in_force(link: AravisLink, settings: GigeSettings, exposure_us: float) -> GigeSettings:
    """The settings with what the camera itself says of region, exposure, PTP and named features."""
    offset_x, offset_y, columns, rows = link.region()
    return settings.model_copy(
        update={
            "features": {name: link.get(name) for name in settings.features},
            "offset_x": offset_x,
            "offset_y": offset_y,
            "columns": columns,
            "rows": rows,
            "exposure_us": exposure_us,
            "ptp_status": link.ptp_status(),
        }
    )
