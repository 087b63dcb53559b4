"""Frames: golden octets, the hash, layouts, and input that is no request."""

from __future__ import annotations

import struct

import pytest
import xxhash
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.dialects.sagitta import client
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.protocol.sagitta import frames
from st_emulator.protocol.sagitta.layout import Field, Kind, Layout, Repeated
from st_emulator.protocol.sagitta.parameters import PARAMETER_TABLE, PARAMETERS
from st_emulator.protocol.sagitta.telemetry import ACTIONS, TELEMETRY
from st_emulator.protocol.sagitta.xxh32 import xxh32

# Hashes: xxhash 4.1.0, XXH32(seed 1425) of the octets between C0 and the hash, low octet first.
GOLDEN = {
    #        C0 start, 21 address, 03 action, 01 boot, 01 region; hash 619A349C; C0 end
    "boot": (frames.MessageType.ACTION, 1, "01", "c0 21030101 9c349a61 c0"),
    #        0E set time; 2026-01-15T00:00:00Z = 1768435200000000 us = 00064861E7E78000 hex, low octet first
    "set_time": (frames.MessageType.ACTION, 14, "0080e7e761480600", "c0 21030e 0080e7e761480600 d78effb4 c0"),
    #        00 set, 12 subscription, 18 solution, 1B temperature, fourteen of 00
    "subscribe": (frames.MessageType.SET_PARAMETER, 18, "181b" + 14 * "00",
                  "c0 210012 181b" + 14 * "00" + "c6b9fe6c c0"),
    #        01 read, 0D matching
    "read": (frames.MessageType.READ_PARAMETER, 13, "", "c0 21010d 76a3fa00 c0"),
    #        02 request, 18 solution
    "solution": (frames.MessageType.REQUEST_TELEMETRY, 24, "", "c0 210218 ac15e176 c0"),
    #        00 set, 1E noise limits: 7505 = 1D51 hex, 40, 0, 255; the hash 57 C0 DB 97 is escaped
    "escaped": (frames.MessageType.SET_PARAMETER, 30, "511d28000000ff00",
                "c0 21001e 511d28000000ff00 57 dbdc dbdd 97 c0"),
}  # fmt: skip


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_requests(name: str) -> None:
    type_, id_, arguments, line = GOLDEN[name]
    wanted = frames.Request(type_, id_, bytes.fromhex(arguments))
    octets = bytes.fromhex(line)
    assert frames.frame_of(frames.request_body(wanted)) == octets
    assert client.request(type_, id_, wanted.arguments) == octets
    unescaped = octets[1:-1].replace(b"\xdb\xdc", b"\xc0").replace(b"\xdb\xdd", b"\xdb")
    assert frames.parse_request(unescaped) == wanted


def test_golden_replies() -> None:
    reply = frames.body_of(frames.MessageType.ACTION_REPLY, 1, b"\x00")
    assert reply == bytes.fromhex("21830100 d802d483")
    # 81 13 without status: .0121 = 3C463F14, .003025 = 3B463F14
    values = struct.pack("<2f", 0.0121, 0.003025)
    read = frames.body_of(frames.MessageType.PARAMETER, 13, values)
    assert read == bytes.fromhex("21810d 143f463c 143f463b 1fe47a1a")


def test_the_hash_of_known_texts() -> None:
    # The algorithm's published values with seed 0.
    assert xxh32(b"", 0) == 0x02CC5D05
    assert xxh32(b"abc", 0) == 0x32D153FF


@given(st.binary(max_size=200), st.integers(0, 2**32 - 1))
def test_the_hash_is_that_of_the_library(data: bytes, seed: int) -> None:
    assert xxh32(data, seed) == xxhash.xxh32(data, seed=seed).intdigest()


def test_sizes_are_those_of_the_table() -> None:
    assert {id_: entry.arguments.octets for id_, entry in PARAMETERS.items()} == client.PARAMETER_BYTES
    assert {
        id_: 16 + entry.data.octets + 4 for id_, entry in TELEMETRY.items()
    } == client.TELEMETRY_BODY_BYTES
    assert {id_: entry.arguments.octets for id_, entry in ACTIONS.items()} == {1: 1, 14: 8}


def test_defaults_are_those_of_the_table() -> None:
    assert {entry.id: entry.arguments.defaults for entry in PARAMETER_TABLE} == client.DEFAULTS


def test_what_is_no_request() -> None:
    good = client.body(client.READ, 13)
    assert frames.parse_request(good) == frames.Request(frames.MessageType.READ_PARAMETER, 13, b"")
    for octets, reason in (
        (b"", "SHORT"),
        (good[:-1], "SHORT"),
        (client.body(client.SET, 3, bytes(128)), "LONG"),
        (client.body(client.READ, 13, address=0x22), "ADDRESS"),
        (good[:-1] + bytes([good[-1] ^ 1]), "HASH"),
        (client.body(4, 13), "TYPE"),
        (client.body(0x81, 13), "TYPE"),
    ):
        assert frames.parse_request(octets) == frames.BadRequest(frames.RefusedFrame[reason])
    unchecked = frames.parse_request(good[:-1] + bytes([good[-1] ^ 1]), hash_checked=False)
    assert isinstance(unchecked, frames.Request)


@given(st.binary(max_size=160))
def test_nothing_raises(data: bytes) -> None:
    frames.parse_request(data)
    frames.parse_request(bytes([0x21]) + data, hash_checked=False)
    for entry in PARAMETER_TABLE:
        values = entry.arguments.unpack(data)
        assert (values is None) == (len(data) != entry.arguments.octets)


LAYOUT = Layout(
    (
        Field("a", Kind.U8),
        Field("b", Kind.F32, count=2, default=(1.0, 2.0)),
        Field("i", Kind.I16),
        Repeated("rows", 2, (Field("x", Kind.U16), Field("y", Kind.U32))),
    )
)


def test_a_layout_packs_what_it_is_given() -> None:
    rows = [{"x": 1, "y": 2}, {"x": 3}]
    packed = LAYOUT.pack("m", {"a": 255, "i": -2, "rows": rows})
    assert packed == struct.pack("<BffhHIHI", 255, 1, 2, -2, 1, 2, 3, 0)
    assert LAYOUT.unpack(packed) == {
        "a": 255,
        "b": [1.0, 2.0],
        "i": -2,
        "rows": [{"x": 1, "y": 2}, {"x": 3, "y": 0}],
    }


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"c": 1}, "c"),
        ({"a": 256}, "a"),
        ({"a": 1.0}, "a"),
        ({"a": True}, "a"),
        ({"b": 1.0}, "b"),
        ({"b": [1.0, "x"]}, "b"),
        ({"b": [1.0, 1e39]}, "b"),
        ({"b": [1.0, float("nan")]}, "b"),
        ({"i": 40000}, "i"),
        ({"rows": [{}]}, "rows"),
        ({"rows": [{}, 1]}, "rows[1]"),
        ({"rows": [{}, {"y": -1}]}, "rows[1].y"),
    ],
)
def test_a_layout_names_what_does_not_fit(values: dict, field: str) -> None:
    with pytest.raises(LocalProtocolError) as caught:
        LAYOUT.pack("message", values)
    assert (caught.value.message, caught.value.field) == ("message", field)
