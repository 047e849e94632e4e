"""The shape of a run file: which NeXus groups and datasets there are, and how they are made.

`docs/reference/run-file.md` draws the tree. Everything exists, links and attributes included, before the
file is switched to single-writer-multiple-reader mode, because nothing can be added after that.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermacq.errors import StoreError
from thermacq.store.codec import Compression, filter_options
from thermacq.store.records import CameraStream, ProbeStream, RunHeader

if TYPE_CHECKING:
    import h5py

    from thermacq_calibration import CameraCorrection

FORMAT_VERSION = 1
SUMMARY_BYTES = 256 * 1024
END_REASON_BYTES = 400
DEVICE_BYTES = 64
KIND_BYTES = 32
DETAIL_BYTES = 200

ENTRY = "entry"
DETAILS = "thermacq"
"""Group of each run and device that holds what NeXus has no name for."""
CORRECTIONS = "corrections"
"""Group within `DETAILS` of the run, with one group for each corrected camera; only there when there are any."""
COMMITTED = "committed"

# dtype and unit of each column; the names are those of `FrameTable`, plus the time for viewers
FRAME_COLUMNS: dict[str, tuple[str, str]] = {
    "counter": ("i8", ""),
    "sequence_number": ("i8", ""),
    "ticks": ("i8", ""),
    "host_ns": ("i8", "ns"),
    "trigger_index": ("i8", ""),
    "trigger_ns": ("i8", "ns"),
    "flags": ("u4", ""),
    "fpa_temperature_k": ("f8", "K"),
    "crc32": ("u4", ""),
    "time": ("f8", "s"),
}
SAMPLE_COLUMNS: dict[str, tuple[str, str]] = {
    "ticks": ("i8", ""),
    "index": ("i8", ""),
    "host_ns": ("i8", "ns"),
    "time": ("f8", "s"),
}
EVENT_COLUMNS: dict[str, tuple[str, str]] = {
    "host_ns": ("i8", "ns"),
    "device": (f"S{DEVICE_BYTES}", ""),
    "kind": (f"S{KIND_BYTES}", ""),
    "index": ("i8", ""),
    "detail": (f"S{DETAIL_BYTES}", ""),
}
_ROWS_PER_CHUNK = 1024
_NAME = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_.]*[A-Za-z0-9_])?")
_TAKEN = frozenset(
    ("instrument", "events", DETAILS, "title", "start_time", "end_time", "entry_identifier", "program_name")
)


def check_names(cameras: list[CameraStream], probes: list[ProbeStream]) -> None:
    """Refuse device names that cannot be names in the file.

    Raises
    ------
    StoreError
        A name is doubled, taken by the file itself, or not a NeXus name.
    """
    names = _names(cameras, probes)
    for name in names:
        if not _NAME.fullmatch(name) or name in _TAKEN or len(name) > DEVICE_BYTES:
            raise StoreError(
                f"a device cannot be stored under the name '{name}'",
                remedy="Use letters, digits, '_' and '.', at most 64; some names, like 'events', are taken.",
            )
    if len(set(names)) < len(names):
        raise StoreError(f"two devices have the same name: {', '.join(sorted(names))}")


def _names(cameras: list[CameraStream], probes: list[ProbeStream]) -> list[str]:
    return [camera.name for camera in cameras] + [probe.name for probe in probes]


def create_layout(
    file: h5py.File,
    header: RunHeader,
    cameras: list[CameraStream],
    probes: list[ProbeStream],
    compression: Compression,
    corrections: Mapping[str, CameraCorrection],
) -> None:
    """Make every group, dataset, link and attribute of a run file."""
    import h5py

    file.attrs.update(
        NX_class="NXroot",
        default=ENTRY,
        file_name=Path(file.filename).name,
        file_time=header.start_time,
        creator="thermacq",
        creator_version=header.versions.get("thermacq", ""),
        HDF5_Version=h5py.version.hdf5_version,
        h5py_version=h5py.version.version,
    )
    entry = _group(file, ENTRY, "NXentry")
    if names := _names(cameras, probes):
        entry.attrs["default"] = names[0]
    put_text(entry, "title", header.title)
    put_text(entry, "start_time", header.start_time)
    put_text(entry, "end_time", "", 32)
    put_text(entry, "entry_identifier", header.run_id)
    put_text(entry, "program_name", "thermacq")
    details = _create_details(entry, header, cameras, probes)
    if corrections:
        group = _group(details, CORRECTIONS, "NXcollection")
        for name, correction in corrections.items():
            correction.to_group(_group(group, name, "NXcollection"))
    _create_table(_group(entry, "events", "NXcollection"), EVENT_COLUMNS)
    instrument = _group(entry, "instrument", "NXinstrument")
    put_text(instrument, "name", str(header.rig.get("name", "rig")))
    for camera in cameras:
        _create_camera(entry, instrument, header, camera, compression)
    for probe in probes:
        _create_probe(entry, instrument, probe)


def _create_details(
    entry: h5py.Group, header: RunHeader, cameras: list[CameraStream], probes: list[ProbeStream]
) -> h5py.Group:
    details = _group(entry, DETAILS, "NXcollection")
    details.create_dataset("format_version", data=FORMAT_VERSION)
    own = {"rig": header.rig, "calibration": header.calibration, "versions": header.versions}
    rest = {name: value for name, value in asdict(header).items() if name not in own}
    put_text(details, "header", json.dumps(rest))
    for name, value in own.items():
        put_text(details, name, json.dumps(value, indent=1))
    streams = {
        "cameras": [asdict(camera) for camera in cameras],
        "probes": [asdict(probe) for probe in probes],
    }
    put_text(details, "streams", json.dumps(streams))
    put_text(details, "summary", "", SUMMARY_BYTES)
    put_text(details, "end_reason", "", END_REASON_BYTES)
    details.create_dataset("finished", data=np.uint8(0))
    return details


def _create_camera(
    entry: h5py.Group,
    instrument: h5py.Group,
    header: RunHeader,
    camera: CameraStream,
    compression: Compression,
) -> None:
    detector = _group(instrument, camera.name, "NXdetector")
    put_text(detector, "local_name", camera.name)
    put_text(detector, "description", str(camera.identity.get("model", "")))
    put_text(detector, "serial_number", camera.serial)
    if bit_depth := camera.capabilities.get("bit_depth"):
        detector.create_dataset("bit_depth_readout", data=int(bit_depth))
        detector.create_dataset("saturation_value", data=2 ** int(bit_depth) - 1)
    _put_seconds(detector, "count_time", camera.applied.get("exposure_s"))
    rate_hz = header.rig.get("trigger", {}).get("frame_rate_hz")
    _put_seconds(detector, "frame_time", 1 / rate_hz if rate_hz else None)
    data = detector.create_dataset(
        "data",
        (0, camera.rows, camera.columns),
        np.uint16,
        maxshape=(None, camera.rows, camera.columns),
        chunks=(1, camera.rows, camera.columns),
        **filter_options(compression),
    )
    data.attrs.update(units="counts", long_name="raw counts", interpretation="image")
    table = _group(detector, DETAILS, "NXcollection")
    columns = _create_table(table, FRAME_COLUMNS)
    columns["time"].attrs.update(start=header.start_time, long_name="time since the start of the recording")
    detector["sequence_number"] = columns["sequence_number"]
    detector["start_time"] = columns["time"]

    plot = _group(entry, camera.name, "NXdata")
    plot.attrs.update(signal="data", axes=["time", "row", "column"])
    plot["data"] = data
    _link_columns(plot, columns)
    data.dims[0].attach_scale(columns["time"])
    for axis, (name, size) in enumerate((("row", camera.rows), ("column", camera.columns)), start=1):
        scale = plot.create_dataset(name, data=np.arange(size, dtype=np.int32))
        scale.attrs["units"] = "pixel"
        scale.make_scale(name)
        data.dims[axis].attach_scale(scale)


def _create_probe(entry: h5py.Group, instrument: h5py.Group, probe: ProbeStream) -> None:
    sensor = _group(instrument, probe.name, "NXsensor")
    put_text(sensor, "name", probe.name)
    put_text(sensor, "model", str(probe.identity.get("model", "")))
    log = _group(sensor, "value_log", "NXlog")
    channels = len(probe.channels)
    value = log.create_dataset(
        "value", (0, channels), np.float64, maxshape=(None, channels), chunks=(_ROWS_PER_CHUNK, channels)
    )
    value.attrs.update(units=probe.unit, long_name=", ".join(probe.channels))
    table = _group(instrument, f"{probe.name}_{DETAILS}", "NXcollection")
    columns = _create_table(table, SAMPLE_COLUMNS)
    columns["time"].attrs["long_name"] = "time on the probe's own clock"
    table["value"] = value
    log["time"] = columns["time"]
    _create_table(_group(table, "pulses", "NXcollection"), {"ticks": ("i8", "")})

    plot = _group(entry, probe.name, "NXdata")
    plot.attrs.update(signal="value", axes=["time", "channel"])
    plot["value"] = value
    _link_columns(plot, columns)
    value.dims[0].attach_scale(columns["time"])
    channel = plot.create_dataset("channel", data=np.arange(channels, dtype=np.int32))
    channel.make_scale("channel")
    value.dims[1].attach_scale(channel)


def _create_table(group: h5py.Group, columns: dict[str, tuple[str, str]]) -> dict[str, h5py.Dataset]:
    """Empty columns that grow together, and the count of committed rows that readers trust."""
    made = {}
    for name, (dtype, unit) in columns.items():
        made[name] = group.create_dataset(name, (0,), dtype, maxshape=(None,), chunks=(_ROWS_PER_CHUNK,))
        if unit:
            made[name].attrs["units"] = unit
    group.create_dataset(COMMITTED, data=np.uint64(0))
    return made


def _link_columns(plot: h5py.Group, columns: dict[str, h5py.Dataset]) -> None:
    """Show the columns beside the data, along the same axis."""
    time = columns["time"]
    time.make_scale("time")
    for name, column in columns.items():
        plot[name] = column
        if name != "time":
            column.dims[0].attach_scale(time)


def _group(parent: h5py.Group, name: str, nexus_class: str) -> h5py.Group:
    group = parent.create_group(name)
    group.attrs["NX_class"] = nexus_class
    return group


def put_text(group: h5py.Group, name: str, text: str, size: int = 0) -> h5py.Dataset:
    """Text in a dataset of fixed size: that of the text, or a larger one to be filled in later."""
    import h5py

    encoded = text.encode()
    dtype = h5py.string_dtype("utf-8", max(size, len(encoded), 1))
    return group.create_dataset(name, data=np.array(encoded, dtype=dtype))


def _put_seconds(group: h5py.Group, name: str, seconds: Any) -> None:
    if isinstance(seconds, int | float):
        group.create_dataset(name, data=float(seconds)).attrs["units"] = "s"


def cut_text(text: str, size: int) -> bytes:
    """UTF-8 bytes of a text, at most `size`, cut between characters."""
    return text.encode(errors="replace")[:size].decode(errors="ignore").encode()


def fit_summary(summary: dict[str, Any]) -> bytes:
    """JSON of the summary; one that is too large loses its long lists, and says so."""
    encoded = json.dumps(summary).encode()
    if len(encoded) > SUMMARY_BYTES:
        encoded = json.dumps(_without_long_lists(summary)).encode()
    if len(encoded) > SUMMARY_BYTES:
        encoded = json.dumps({"note": "the summary was too large to be stored"}).encode()
    return encoded


def _without_long_lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_long_lists(item) for key, item in value.items()}
    if isinstance(value, list) and len(value) > 100:
        return f"{len(value)} entries were left out because the summary was too large"
    return value
