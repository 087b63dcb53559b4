"""The OBC of a long run: telecommands made with struct alone, and what leads a unit back to its work."""

from __future__ import annotations

import random
import struct
from typing import Any, Final

from st_emulator.bench.emulator import Emulator
from st_emulator.clock import NS_PER_S

from .wire import slip_frame, telecommand

SOURCE: Final = 0x2A
BITS_PER_OCTET: Final = 10
FUNCTION: Final = {
    "GO_STANDBY": 1, "START_ACQUISITION": 2, "START_SELF_TEST": 3, "RESET": 4, "CAPTURE_IMAGE": 5,
    "DOWNLOAD_IMAGE": 6, "RESTORE_DEFAULT_PARAMETERS": 10,
}  # fmt: skip
EXPOSURE_US, AUTONOMOUS_START = 1, 18
RAM, PROGRAM = 1, 4
OPERATION: Final = bytes(range(64))


def function(name: str, packed: bytes = b"") -> tuple[str, dict[str, Any]]:
    return "function", {"function_id": FUNCTION[name], "packed": packed}


def parameter(number: int, packed: bytes) -> tuple[str, dict[str, Any]]:
    return "parameter_set", {"id": number, "packed": packed}


#: What an OBC asks while all is well: none of it ends the tracking.
QUIET: Final = (
    ("ping", {}),
    ("hk_one_shot", {"structure_ids": [1, 2, 3]}),
    ("parameter_report", {"parameter_ids": [1, 2, 3]}),
    ("memory_dump", {"memory_id": RAM, "start_address": 0, "length": 200}),
    ("memory_check", {"memory_id": PROGRAM, "start_address": 0, "length": 4096}),
    ("event_report_disabled", {}),
)
#: What it does while something may go wrong.
BUSY: Final = (
    *QUIET,
    parameter(EXPOSURE_US, struct.pack(">I", 100_000)),
    parameter(AUTONOMOUS_START, b"\1"),
    function("GO_STANDBY"),
    function("START_ACQUISITION"),
    function("START_SELF_TEST"),
    function("CAPTURE_IMAGE"),
    function("DOWNLOAD_IMAGE", struct.pack(">HHH", 1, 0, 5)),
    function("RESET", b"\0"),
    function("RESET", b"\1"),
    ("memory_load", {"memory_id": RAM, "start_address": 0, "data": OPERATION}),
)


class SoakObc:
    """Speaks to a unit on its serial line."""

    def __init__(self, emulator: Emulator, chance: random.Random) -> None:
        self._emulator = emulator
        self._chance = chance
        self._count = 0

    def send(self, name: str, fields: dict[str, Any]) -> int:
        """A telecommand now; returns how many octets it has on the line."""
        packet = telecommand(name, fields, apid=self._emulator.profile.apid, count=self._count, source=SOURCE)
        self._count += 1
        octets = slip_frame(packet)
        self._emulator.receive(octets)
        return len(octets)

    def some(self, telecommands: tuple[tuple[str, dict[str, Any]], ...]) -> None:
        """One of them."""
        self.send(*self._chance.choice(telecommands))

    def set_time(self) -> tuple[int, int]:
        """Any time. Returns (seconds of TAI, virtual ns at which they hold: the last bit's arrival)."""
        seconds = self._chance.randrange(2_000_000_000, 2_200_000_000)
        sent_ns = self._emulator.now_ns
        octets = self.send("set_time", {"seconds": seconds})
        return seconds, sent_ns + octets * BITS_PER_OCTET * NS_PER_S // self._emulator.baud

    def start_anew(self) -> None:
        """Whatever it has come to: good parameters, and a start."""
        for one in (
            function("GO_STANDBY"),
            function("RESTORE_DEFAULT_PARAMETERS"),
            parameter(AUTONOMOUS_START, b"\1"),
            function("RESET", b"\0"),
        ):
            self.send(*one)
            self.wait(0.5)

    def wait(self, seconds: float) -> None:
        self._emulator.advance(self._emulator.now_ns + round(seconds * NS_PER_S))
