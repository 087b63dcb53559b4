"""Golden octets: each worked out by hand from the table of the language."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.dialects.nos3 import client
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.protocol.nos3.messages import (
    CODE,
    COMMAND,
    DATA,
    HOUSEKEEPING,
    LAYOUTS,
    README,
    README_DATA,
    README_HOUSEKEEPING,
    encode_command,
)

GOLDEN_COMMANDS = [
    # header DEAD, number, payload as u32 with the most significant octet first, trailer BEEF
    (CODE, "noop", 0, "dead 00 00000000 beef"),
    (CODE, "housekeeping", 0, "dead 01 00000000 beef"),
    (CODE, "data", 0, "dead 02 00000000 beef"),
    (CODE, "config", 0x01020304, "dead 03 01020304 beef"),
    (README, "housekeeping", 0, "dead 00 00000000 beef"),
    (README, "data", 0xFFFFFFFF, "dead 01 ffffffff beef"),
    (README, "config", 1, "dead 02 00000001 beef"),
]
ATTITUDE = {"q0": 0x8000, "q1": 1, "q2": 0xFFFF, "q3": 0x1234, "valid": 1}
GOLDEN_REPLIES = [
    (HOUSEKEEPING, {"count": 1}, "dead 00000001 beef"),
    (HOUSEKEEPING, {"count": 0xA1B2C3D4}, "dead a1b2c3d4 beef"),
    (DATA, ATTITUDE, "dead 8000 0001 ffff 1234 01 beef"),
    (
        README_HOUSEKEEPING,
        {"count": 5, "configuration": 0x01020304, "status": 2},
        "dead 00000005 01020304 00000002 beef",
    ),
    (README_DATA, {"count": 7, **ATTITUDE}, "dead 00000007 8000 0001 ffff 1234 01 beef"),
]


@pytest.mark.parametrize(("layout", "name", "payload", "octets"), GOLDEN_COMMANDS)
def test_commands(layout, name, payload, octets):
    raw = bytes.fromhex(octets)
    assert encode_command(layout, name, payload) == raw
    assert client.command(name, payload, layout.name) == raw
    assert COMMAND.decode(raw) == {"command": raw[2], "payload": payload}


@pytest.mark.parametrize(("message", "values", "octets"), GOLDEN_REPLIES)
def test_replies(message, values, octets):
    raw = bytes.fromhex(octets)
    assert message.encode(values) == raw
    assert message.decode(raw) == values


def test_lengths():
    assert (COMMAND.octets, HOUSEKEEPING.octets, DATA.octets) == (9, 8, 13)
    assert (README_HOUSEKEEPING.octets, README_DATA.octets) == (16, 17)


@pytest.mark.parametrize("layout", ["code", "readme"])
def test_the_layouts_are_those_of_the_client(layout):
    ours = LAYOUTS[layout]
    assert {command.name: command.number for command in ours.commands} == client.NUMBERS[layout]
    for command in ours.commands:
        size = 0 if command.reply is None else command.reply.octets
        assert size == client.reply_size(command.name, layout)


@given(st.data(), st.sampled_from([HOUSEKEEPING, DATA, README_HOUSEKEEPING, README_DATA, COMMAND]))
def test_there_and_back(data, message):
    values = {field.name: data.draw(st.integers(0, field.highest)) for field in message.variables}
    raw = message.encode(values)
    assert message.decode(raw) == values
    assert raw[:2] + raw[-2:] == struct.pack(">I", 0xDEADBEEF)


@given(st.binary(max_size=20))
def test_what_is_no_such_message(raw):
    for message in (HOUSEKEEPING, DATA, README_HOUSEKEEPING, README_DATA, COMMAND):
        framed = len(raw) == message.octets and raw[:2] == b"\xde\xad" and raw[-2:] == b"\xbe\xef"
        assert (message.decode(raw) is not None) == framed


@pytest.mark.parametrize(
    ("layout", "name", "payload", "said"),
    [
        (CODE, "datum", 0, "noop, housekeeping, data, config"),
        (README, "noop", 0, "housekeeping, data, config"),
        (CODE, "config", 2**32, "from 0 to 4294967295"),
        (CODE, "config", -1, "from 0 to 4294967295"),
        (CODE, "config", 1.0, "from 0 to 4294967295"),
        (CODE, "config", True, "from 0 to 4294967295"),
    ],
)
def test_commands_that_cannot_be_built(layout, name, payload, said):
    with pytest.raises(LocalProtocolError, match=said):
        encode_command(layout, name, payload)


@pytest.mark.parametrize("values", [{}, {"count": 2**32}, {"count": None}, {"count": 1, "status": 0}])
def test_replies_that_cannot_be_built(values):
    with pytest.raises(LocalProtocolError):
        HOUSEKEEPING.encode(values)
