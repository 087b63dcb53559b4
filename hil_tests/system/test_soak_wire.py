"""The long run's own wire against the reference decoder."""

from __future__ import annotations

import random
from typing import Any

import pytest

from hil_tests.vectors import reference_decoder as wire
from tools.soaking.obc import BUSY, FUNCTION
from tools.soaking.wire import crc16, kind_of, slip_frame, telecommand

DATA = bytes(range(64))
#: The same telecommands in the words of the reference.
WORDS: dict[str, Any] = {
    "memory_load": {"memory_id": 1, "start_address": 0, "data": DATA, "checksum": wire.crc16(DATA)},
}
ARGUMENTS: dict[int, list[dict[str, int]]] = {
    FUNCTION["RESET"]: [{"kind": 0}, {"kind": 1}],
    FUNCTION["DOWNLOAD_IMAGE"]: [{"transaction_id": 1, "first_part": 0, "parts": 5}],
}
SETTINGS = {1: 100_000, 18: 1}


def in_words(name: str, fields: dict[str, Any]) -> list[dict[str, Any]]:
    if name == "function":
        arguments = ARGUMENTS.get(fields["function_id"], [{}])
        return [{"function_id": fields["function_id"], "arguments": one} for one in arguments]
    if name == "parameter_set":
        return [{"settings": [{"parameter_id": fields["id"], "value": SETTINGS[fields["id"]]}]}]
    return [WORDS.get(name, fields)]


@pytest.mark.parametrize(("name", "fields"), [*BUSY, ("set_time", {"seconds": 2_100_000_000})])
def test_a_telecommand(name: str, fields: dict[str, Any]) -> None:
    made = telecommand(name, fields, apid=0x155, count=0x4001, source=0x2A)
    words = [{"time": (2_100_000_000, 0)}] if name == "set_time" else in_words(name, fields)
    assert made in [wire.encode_telecommand(name, one, 0x155, 1, 0x2A, 15) for one in words]
    assert wire.slip_frame(made) == slip_frame(made)
    assert kind_of(slip_frame(made)[1:-1]) is None, "no telemetry"


def test_check_sum_and_damage() -> None:
    chance = random.Random(1)
    for length in range(200):
        data = chance.randbytes(length)
        assert crc16(data) == wire.crc16(data)
    body = bytes([0x20, 130, 1]) + bytes(11) + b"\xc0\xdb content"
    packet = bytes([0x09, 0x55, 0xC0, 7]) + (len(body) + 1).to_bytes(2, "big") + body
    packet += wire.crc16(packet).to_bytes(2, "big")
    assert wire.decode_packet(packet)["service"] == 130
    frame = slip_frame(packet)[1:-1]
    assert kind_of(frame) == (130, 1)
    for place in range(len(frame)):
        for bit in range(8):
            spoilt = bytearray(frame)
            spoilt[place] ^= 1 << bit
            assert kind_of(bytes(spoilt)) is None
    for end in range(len(frame)):
        assert kind_of(frame[:end]) is None
