"""An open camera as Aravis sees it: its features, its triggers, its stream.

Every wait is bounded by Aravis: a command that stays without an answer ends after about 2.5 s (five
attempts of 0.5 s). Objects are made and dropped in the process of the device only.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thermacq_drivers.gige.aravis import FoundCamera, LinkError, asking, load

if TYPE_CHECKING:
    from thermacq_drivers.gige.settings import GigeSettings

# GenICam nodes of the precision time protocol: enable and status; newer names first.
_PTP_NODES = (("PtpEnable", "PtpStatus"), ("GevIEEE1588", "GevIEEE1588Status"))
_FIRMWARE_NODES = ("DeviceFirmwareVersion", "DeviceVersion")


@dataclass(frozen=True)
class Delivery:
    """One buffer as it came from the stream.

    Parameters
    ----------
    problem
        Empty when the picture is complete, else what is wrong with it, in Aravis' words.
    frame_id
        As delivered; wraps at 16 bits unless the camera has wider ids.
    timestamp_ns
        Clock of the camera, converted to nanoseconds by its tick frequency; 0 when it has none.
    columns, rows
        Size of the picture; 0 when it is not known.
    data
        The pixels, packed rows.
    """

    problem: str
    frame_id: int
    timestamp_ns: int
    columns: int
    rows: int
    data: bytes


class AravisLink:
    """An open camera.

    Parameters
    ----------
    id_or_address
        What `list_cameras` calls it, or its IP address.

    Raises
    ------
    LinkError
        It does not answer, or another program controls it.
    """

    def __init__(self, id_or_address: str) -> None:
        self._aravis = load()
        self._stream: Any = None
        self._lost = threading.Event()
        self._underruns = 0
        with asking():
            self._camera = self._aravis.Camera.new(id_or_address)
            self._device = self._camera.get_device()
        self._is_gv = bool(self._camera.is_gv_device())
        if self._is_gv and not self._device.is_controller():
            raise LinkError("another program, or another camera of this rig, controls it")
        # The handler must not know this object: Aravis would keep both alive for ever.
        lost = self._lost
        self._handler = self._device.connect("control-lost", lambda _device: lost.set())
        self._camera.set_range_check_policy(self._aravis.RangeCheckPolicy.ENABLE)

    @property
    def lost(self) -> bool:
        """Whether the camera was given up: by Aravis' heartbeat, or because a command stayed unanswered."""
        return self._lost.is_set()

    @contextmanager
    def _asking(self) -> Iterator[None]:
        try:
            with asking():
                yield
        except LinkError as error:
            if error.gone:
                self._lost.set()
            raise

    def about(self) -> FoundCamera:
        """Which individual this is."""
        camera = self._camera
        with self._asking():
            firmware = next((self.get(name) for name in _FIRMWARE_NODES if self.has(name)), "")
            return FoundCamera(
                id=camera.get_device_id() or "",
                vendor=camera.get_vendor_name() or "",
                model=camera.get_model_name() or "",
                serial=camera.get_device_serial_number() or "",
                firmware=str(firmware),
            )

    def has(self, feature: str) -> bool:
        """Whether the camera has a feature and it can be used now."""
        with self._asking():
            return bool(self._camera.is_feature_available(feature))

    def get(self, feature: str) -> bool | int | float | str:
        """Value of a feature; of a command always true."""
        aravis, device = self._aravis, self._device
        with self._asking():
            node = device.get_feature(feature)
            if node is None:
                raise LinkError(f"it has no feature '{feature}'")
            if isinstance(node, aravis.GcCommand):
                return True
            if isinstance(node, aravis.GcBoolean):
                return bool(device.get_boolean_feature_value(feature))
            if isinstance(node, aravis.GcEnumeration | aravis.GcString):
                return str(device.get_string_feature_value(feature))
            if isinstance(node, aravis.GcFloat):
                return float(device.get_float_feature_value(feature))
            return int(device.get_integer_feature_value(feature))

    def set(self, feature: str, value: bool | float | str) -> None:
        """Set a feature by the type of its node; a command is run when `value` is true."""
        aravis, device = self._aravis, self._device
        with self._asking():
            node = device.get_feature(feature)
            if node is None:
                raise LinkError(f"it has no feature '{feature}'")
            wrong = LinkError(f"feature '{feature}' cannot be set to {value!r}")
            if isinstance(node, aravis.GcCommand):
                if value is True:
                    device.execute_command(feature)
            elif isinstance(node, aravis.GcBoolean):
                if not isinstance(value, bool):
                    raise wrong
                device.set_boolean_feature_value(feature, value)
            elif isinstance(node, aravis.GcEnumeration | aravis.GcString):
                if not isinstance(value, str):
                    raise wrong
                device.set_string_feature_value(feature, value)
            elif isinstance(value, str):
                raise wrong
            elif isinstance(node, aravis.GcFloat):
                device.set_float_feature_value(feature, float(value))
            elif float(value).is_integer():
                device.set_integer_feature_value(feature, int(value))
            else:
                raise wrong

    def region(self) -> tuple[int, int, int, int]:
        """Region in force: offset in x and y, columns, rows."""
        with self._asking():
            region = self._camera.get_region()
        return region.x, region.y, region.width, region.height

    def set_region(self, x: int, y: int, columns: int, rows: int) -> None:
        """Set the region; 0 columns or rows: as far as the sensor reaches."""
        camera = self._camera
        with self._asking():
            # Offsets go to 0 first, or a larger size would be refused after a smaller region.
            camera.set_region(0, 0, -1, -1)
            widest, highest = camera.get_width_bounds()[1], camera.get_height_bounds()[1]
            camera.set_region(-1, -1, columns or widest - x, rows or highest - y)
            camera.set_region(x, y, -1, -1)

    def set_pixel_format(self, name: str) -> None:
        """Set the pixel format."""
        with self._asking():
            known = self._camera.dup_available_pixel_formats_as_strings()
            if name not in known:
                raise LinkError(f"it has no pixel format {name}; it has {', '.join(known)}")
            self._camera.set_pixel_format_from_string(name)

    def set_exposure_us(self, exposure_us: float) -> float:
        """Set the exposure time unless 0 is asked; returns the one in force, 0 when there is none."""
        camera = self._camera
        with self._asking():
            if not camera.is_exposure_time_available():
                if exposure_us > 0:
                    raise LinkError("its exposure time cannot be set")
                return 0.0
            if exposure_us > 0:
                camera.set_exposure_time(exposure_us)
            return float(camera.get_exposure_time())

    def max_frame_rate_hz(self) -> float:
        """Highest frame rate with the region in force; 0 when the camera does not say."""
        with self._asking():
            if not self._camera.is_frame_rate_available():
                return 0.0
            return float(self._camera.get_frame_rate_bounds()[1])

    def set_frame_rate(self, frame_rate_hz: float) -> float:
        """Set the frame rate; returns the one in force, 0 when the camera has no such feature."""
        with self._asking():
            if not self._camera.is_frame_rate_available():
                return 0.0
            self._camera.set_frame_rate(frame_rate_hz)
            return float(self._camera.get_frame_rate())

    def trigger_sources(self) -> tuple[str, ...]:
        """Names of the trigger sources; empty when the camera cannot be triggered."""
        with self._asking():
            if not self.has("TriggerSource"):
                return ()
            return tuple(self._camera.dup_available_trigger_sources())

    def set_trigger(self, source: str) -> None:
        """Wait for triggers of a source; empty: run free."""
        with self._asking():
            if source:
                self._camera.set_trigger(source)
            elif self.has("TriggerSelector"):
                self._camera.clear_triggers()

    def software_trigger(self) -> None:
        """Expose now."""
        with self._asking():
            self._camera.software_trigger()

    def enable_ptp(self) -> None:
        """Let PTP set the camera's clock."""
        enable = next((enable for enable, _ in _PTP_NODES if self.has(enable)), "")
        if not enable:
            raise LinkError("it has no PTP")
        self.set(enable, True)

    def ptp_status(self) -> str:
        """PTP status now, e.g. ``Slave``; empty when the camera has no PTP."""
        if self.has("PtpDataSetLatch"):
            self.set("PtpDataSetLatch", True)
        return next((str(self.get(status)) for _, status in _PTP_NODES if self.has(status)), "")

    def alive(self) -> bool:
        """Ask the camera for something; takes about 2.5 s when it does not answer."""
        try:
            with self._asking():
                self._camera.get_payload()
        except LinkError:
            return False
        return not self.lost

    def packet_size(self) -> int:
        """Packet size in force; 0 for USB3 Vision cameras, which have none."""
        if not self._is_gv:
            return 0
        with self._asking():
            return int(self._camera.gv_get_packet_size())

    def set_packet_size(self, size: int) -> int:
        """Set the packet size; returns the one in force. USB3 Vision cameras have none."""
        if not self._is_gv:
            return size
        with self._asking():
            self._camera.gv_set_packet_size(size)
            return int(self._camera.gv_get_packet_size())

    def prepare_stream(self, settings: GigeSettings) -> int:
        """Make the stream and its buffers; returns the receive buffer that the system granted, bytes."""
        aravis, camera = self._aravis, self._camera
        self.drop_stream()
        granted = settings.socket_buffer_bytes
        with self._asking():
            if self._is_gv:
                camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
            stream = camera.create_stream(None, None)
            if self._is_gv:
                for name, value in _stream_properties(aravis, settings).items():
                    stream.set_property(name, value)
                granted = _enlarge_receive_buffer(stream.get_port(), settings.socket_buffer_bytes)
            payload = camera.get_payload()
            for _ in range(settings.buffers):
                stream.push_buffer(aravis.Buffer.new_allocate(payload))
        self._stream, self._underruns = stream, 0
        return granted

    def start(self) -> None:
        """Start acquiring into the prepared stream."""
        with self._asking():
            self._camera.start_acquisition()

    def stop(self) -> None:
        """Stop acquiring."""
        with self._asking():
            self._camera.stop_acquisition()

    def pop(self, timeout_s: float) -> Delivery | None:
        """Wait for the next buffer, copy it, and give it back to the stream."""
        stream = self._stream
        buffer = (
            stream.timeout_pop_buffer(round(timeout_s * 1e6)) if timeout_s > 0 else stream.try_pop_buffer()
        )
        if buffer is None:
            return None
        status = buffer.get_status()
        complete = status == self._aravis.BufferStatus.SUCCESS
        delivery = Delivery(
            problem="" if complete else status.value_nick.replace("-", " "),
            frame_id=int(buffer.get_frame_id()),
            timestamp_ns=int(buffer.get_timestamp()),
            columns=buffer.get_image_width() if complete else 0,
            rows=buffer.get_image_height() if complete else 0,
            data=buffer.get_image_data() if complete else buffer.get_data(),
        )
        stream.push_buffer(buffer)
        return delivery

    def ran_short_of_buffers(self) -> bool:
        """Whether packets found no free buffer since the last call."""
        before, self._underruns = self._underruns, self.statistics().get("n_underruns", 0)
        return self._underruns > before

    def statistics(self) -> Mapping[str, int]:
        """Counts of the stream since it was prepared, by Aravis' names, e.g. ``n_missing_packets``."""
        stream = self._stream
        if stream is None:
            return {}
        names = [stream.get_info_name(i) for i in range(stream.get_n_infos())]
        return {name: int(stream.get_info_uint64_by_name(name)) for name in names}

    def drop_stream(self) -> None:
        """Let go of the stream; takes about 2.5 s when the camera does not answer."""
        self._stream = None

    def drop(self) -> None:
        """Let go of everything; takes about 5 s when the camera does not answer."""
        self.drop_stream()
        with suppress(AttributeError, TypeError):
            self._device.disconnect(self._handler)
        self._device = self._camera = None


def _stream_properties(aravis: Any, settings: GigeSettings) -> dict[str, Any]:
    resend = aravis.GvStreamPacketResend
    return {
        "socket-buffer": aravis.GvStreamSocketBuffer.FIXED,
        "socket-buffer-size": settings.socket_buffer_bytes,
        "packet-resend": resend.ALWAYS if settings.packet_resend else resend.NEVER,
        "packet-request-ratio": settings.packet_request_ratio,
        "packet-timeout": round(settings.packet_timeout_ms * 1e3),
        "frame-retention": round(settings.frame_retention_ms * 1e3),
    }


def _enlarge_receive_buffer(port: int, size: int) -> int:
    """Enlarge the receive buffer of this process' UDP socket on a port; returns the size granted.

    Aravis does so itself only after the first packets have come, too late for the first frame.
    """
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            if not str(entry.readlink()).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry.name))) as found:
                if found.family != socket.AF_INET or found.getsockname()[1] != port:
                    continue
                found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
                # The kernel doubles what is asked, for its own bookkeeping.
                return found.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    return size
