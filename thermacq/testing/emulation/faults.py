"""Faults that an emulated device acts out by schedule, and the record of those that it did act out.

One model for every emulator: a fault strikes at an item (frame, block or answer, as the emulator counts
them from 0 since it came to life) or at a time. Each one that struck is counted and written to a file in the folder
of the recording, so that what was injected can be held against what was handled.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from thermacq.hooks import Emulation
from thermacq.timing.clock import NS_PER_S, Clock


class FaultKind(StrEnum):
    """What can go wrong with a device or its cable."""

    TIMEOUT = "timeout"
    """Nothing is answered to this item (for `seconds`, or only this one)."""
    SHORT_READ = "short_read"
    """The last `amount` bytes of this item do not come."""
    STALL = "stall"
    """The USB endpoint halts until the host clears it; on other transports as `timeout`."""
    DISCONNECT = "disconnect"
    """The cable is pulled; plugged again after `seconds`, or never when 0."""
    BAD_CRC = "bad_crc"
    """The item arrives damaged, so that its checksum (or marker) does not fit."""
    DROP = "drop"
    """The device loses the item; its counter goes on."""
    DUPLICATE = "duplicate"
    """The item comes twice, with the same counter."""
    SHUTTER_FREEZE = "shutter_freeze"
    """The shutter closes for `seconds`: the picture stands still."""
    COUNTER_JUMP = "counter_jump"
    """The frame counter leaps by `amount`."""
    GARBAGE = "garbage"
    """`amount` bytes that mean nothing come before the item."""
    SLOW = "slow"
    """The item comes `seconds` late."""


class FaultSettings(BaseModel):
    """One fault of a schedule, e.g. ``{kind = "disconnect", at = 100, seconds = 2.0}``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: FaultKind
    at: int = Field(-1, ge=-1, description="item (frame, block, answer) that it strikes, from 0")
    at_s: float = Field(-1.0, ge=-1, description="instead of `at`: the first item this long after the start")
    items: int = Field(1, ge=1, description="consecutive items that it strikes")
    seconds: float = Field(0.0, ge=0, le=3600, description="how long it lasts, where it lasts")
    amount: int = Field(1, ge=1, description="bytes, or counts, where there is an amount")

    @model_validator(mode="after")
    def _one_time(self) -> FaultSettings:
        if (self.at >= 0) == (self.at_s >= 0):
            raise ValueError("say when it strikes: 'at' (an item) or 'at_s' (seconds), one of them")
        return self


class EmulatorSettings(BaseModel):
    """What every emulator can be told in the rig table ``[emulation.DEVICE]``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    serial: str = Field("", description="serial number of the device; empty: made from its name")
    clock_ppm: float = Field(0.0, gt=-1e4, lt=1e4, description="error of its clock: positive is fast")
    faults: tuple[FaultSettings, ...] = Field(default=(), description="faults that it acts out")

    def serial_for(self, name: str) -> str:
        """Serial number of the emulated device that plays device `name` of the rig."""
        return self.serial or f"EMU-{name}"


class FaultSchedule:
    """The faults of one device, and how many struck.

    Parameters
    ----------
    faults
        The schedule.
    clock
        Host clock; `at_s` counts from now.
    log
        File to which each fault that struck is appended as a line of JSON; None writes none.
    """

    def __init__(self, faults: Sequence[FaultSettings], clock: Clock, log: Path | None = None) -> None:
        self._clock = clock
        self._start_ns = clock.now_ns()
        self._log = log
        # Items that each fault still strikes; those set by time get their item when the time has come.
        self._left = {index: fault.items for index, fault in enumerate(faults)}
        self._faults = tuple(faults)
        self.injected: Counter[FaultKind] = Counter()

    def strike(self, item: int, *kinds: FaultKind) -> list[FaultSettings]:
        """Faults that strike this item, noted as injected.

        Parameters
        ----------
        item
            Frame, block or answer, from 0; must not go back.
        kinds
            Ask for these only, when several parts of an emulator share the schedule; all by default.
        """
        struck = [
            index
            for index, fault in enumerate(self._faults)
            if self._left[index] > 0 and (not kinds or fault.kind in kinds) and self._is_due(fault, item)
        ]
        for index in struck:
            self._left[index] -= 1
            self._note(self._faults[index].kind, item)
        return [self._faults[index] for index in struck]

    def _is_due(self, fault: FaultSettings, item: int) -> bool:
        if fault.at >= 0:
            return item >= fault.at
        now_ns = self._clock.now_ns()
        # Virtual time begins anew with the recording, and the count with it.
        self._start_ns = min(self._start_ns, now_ns)
        return now_ns - self._start_ns >= fault.at_s * NS_PER_S

    def _note(self, kind: FaultKind, item: int) -> None:
        self.injected[kind] += 1
        if self._log is not None:
            with self._log.open("a", encoding="utf-8") as log:
                log.write(json.dumps({"host_ns": self._clock.now_ns(), "fault": kind, "item": item}) + "\n")


def schedule_for(emulation: Emulation, settings: EmulatorSettings) -> FaultSchedule:
    """Schedule of an emulated device, logged where the host of the device looks for it."""
    return FaultSchedule(settings.faults, emulation.clock, emulation.fault_log)


def damaged(data: bytes, fault: FaultSettings) -> bytes:
    """Bytes of an item as they arrive with a fault of the wire; other kinds leave them as they are."""
    if fault.kind is FaultKind.GARBAGE:
        # Seeded by its length: the same fault gives the same bytes.
        return np.random.default_rng(fault.amount).bytes(fault.amount) + data
    if fault.kind is FaultKind.SHORT_READ:
        return data[: -fault.amount]
    if fault.kind is FaultKind.BAD_CRC and data:
        return data[:-1] + bytes([data[-1] ^ 0x55])
    if fault.kind is FaultKind.DUPLICATE:
        return data + data
    if fault.kind in (FaultKind.DROP, FaultKind.TIMEOUT, FaultKind.STALL):
        return b""
    return data
