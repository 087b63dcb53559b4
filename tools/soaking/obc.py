"""The OBC of a long run: telecommands made with struct alone, and what leads a unit back to its work."""

from __future__ import annotations

import random
from typing import Any, Final

from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.emulator import Emulator
from st_emulator.clock import NS_PER_S

SOURCE: Final = 0x2A
BITS_PER_OCTET: Final = 10
FUNCTION: Final = {
    "GO_STANDBY": 1, "START_ACQUISITION": 2, "START_SELF_TEST": 3, "RESET": 4, "CAPTURE_IMAGE": 5,
    "DOWNLOAD_IMAGE": 6, "RESTORE_DEFAULT_PARAMETERS": 10,
}  # fmt: skip
EXPOSURE_US, AUTONOMOUS_START = 1, 18
RAM, PROGRAM = 1, 4
OPERATION: Final = bytes(range(64))


def function(name: str, **arguments: int) -> tuple[str, dict[str, Any]]:
    return "function", {"function_id": FUNCTION[name], "arguments": arguments}


def parameter(number: int, value: float) -> tuple[str, dict[str, Any]]:
    return "parameter_set", {"settings": [{"parameter_id": number, "value": value}]}


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
    parameter(EXPOSURE_US, 100_000),
    parameter(AUTONOMOUS_START, 1),
    function("GO_STANDBY"),
    function("START_ACQUISITION"),
    function("START_SELF_TEST"),
    function("CAPTURE_IMAGE"),
    function("DOWNLOAD_IMAGE", transaction_id=1, first_part=0, parts=5),
    function("RESET", kind=0),
    function("RESET", kind=1),
    (
        "memory_load",
        {"memory_id": RAM, "start_address": 0, "data": OPERATION, "checksum": wire.crc16(OPERATION)},
    ),
)


class SoakObc:
    """Speaks to a unit on its serial line."""

    def __init__(self, emulator: Emulator, chance: random.Random) -> None:
        self._emulator = emulator
        self._chance = chance
        self._count = 0

    def send(self, name: str, fields: dict[str, Any]) -> int:
        """A telecommand now; returns how many octets it has on the line."""
        packet = wire.encode_telecommand(
            name,
            fields,
            sequence_count=self._count & 0x3FFF,
            ack=15,
            apid=self._emulator.profile.apid,
            source_id=SOURCE,
        )
        self._count += 1
        octets = wire.slip_frame(packet)
        self._emulator.receive(octets)
        return len(octets)

    def some(self, telecommands: tuple[tuple[str, dict[str, Any]], ...]) -> None:
        """One of them."""
        self.send(*self._chance.choice(telecommands))

    def set_time(self) -> tuple[int, int]:
        """Any time. Returns (seconds of TAI, virtual ns at which they hold: the last bit's arrival)."""
        seconds = self._chance.randrange(2_000_000_000, 2_200_000_000)
        sent_ns = self._emulator.now_ns
        octets = self.send("set_time", {"time": (seconds, 0)})
        return seconds, sent_ns + octets * BITS_PER_OCTET * NS_PER_S // self._emulator.baud

    def start_anew(self) -> None:
        """Whatever it has come to: good parameters, and a start."""
        for telecommand in (
            function("GO_STANDBY"),
            function("RESTORE_DEFAULT_PARAMETERS"),
            parameter(AUTONOMOUS_START, 1),
            function("RESET", kind=0),
        ):
            self.send(*telecommand)
            self.wait(0.5)

    def wait(self, seconds: float) -> None:
        self._emulator.advance(self._emulator.now_ns + round(seconds * NS_PER_S))
