"""Golden packets written by hand: our codec, both ways, and the reference decoder against them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hil_tests.vectors import reference_decoder
from st_emulator.protocol import (
    CucTime,
    FrameReceived,
    Malformed,
    SlipDecoder,
    crc16_ccitt,
    encode_telecommand,
    encode_telemetry,
    parse_telecommand,
    parse_telemetry,
    slip_encode,
)

FILE = Path(__file__).parents[1] / "vectors" / "golden_packets.json"
VECTORS = {vector["name"]: vector for vector in json.loads(FILE.read_text())["vectors"]}
EACH = pytest.mark.parametrize("vector", VECTORS.values(), ids=VECTORS)


def packet_of(vector: dict[str, Any]) -> bytes:
    return b"".join(bytes.fromhex(part["hex"]) for part in vector["bytes"])


def native(value: Any, time: Any = CucTime) -> Any:
    """Fields as the file writes them to fields as the codec has them."""
    if isinstance(value, dict):
        if "$time" in value:
            return time(*value["$time"])
        if "$hex" in value:
            return bytes.fromhex(value["$hex"])
        return {name: native(item, time) for name, item in value.items()}
    if isinstance(value, list):
        return [native(item, time) for item in value]
    return value


def encode(vector: dict[str, Any]) -> bytes:
    header = dict(vector["header"])
    if vector["kind"] == "TC":
        return encode_telecommand(vector["message"], native(vector["fields"]), **header)
    header["time"] = CucTime(**header["time"])
    return encode_telemetry(vector["message"], native(vector["fields"]), **header)


@EACH
def test_every_byte_has_an_origin_and_the_crc_holds(vector: dict[str, Any]) -> None:
    assert all(part["origin"] and part["hex"] for part in vector["bytes"])
    packet = packet_of(vector)
    assert reference_decoder.crc16(packet) == 0
    assert crc16_ccitt(packet) == 0


@EACH
def test_we_build_it(vector: dict[str, Any]) -> None:
    assert encode(vector).hex(" ") == packet_of(vector).hex(" ")


@EACH
def test_we_read_it(vector: dict[str, Any]) -> None:
    parse = parse_telecommand if vector["kind"] == "TC" else parse_telemetry
    packet = parse(packet_of(vector))
    assert not isinstance(packet, Malformed), packet
    assert packet.name == vector["message"]
    assert packet.fields == native(vector["fields"])
    for name, value in vector["header"].items():
        expected = CucTime(**value) if name == "time" else value
        assert getattr(packet, name) == expected, name


@EACH
def test_the_reference_agrees(vector: dict[str, Any]) -> None:
    def pair(coarse: int, fine: int) -> tuple[int, int]:
        return (coarse, fine)

    fields = native(vector["fields"], pair)
    header = vector["header"]
    if vector["kind"] == "TC":
        built = reference_decoder.encode_telecommand(vector["message"], fields, **header)
        assert built == packet_of(vector)
    else:
        packet = reference_decoder.decode_telemetry(packet_of(vector))
        assert packet["name"] == vector["message"]
        assert packet["fields"] == fields
        assert packet["time"] == pair(**header["time"])


@pytest.mark.parametrize("name", [name for name, vector in VECTORS.items() if "line" in vector])
def test_its_frame_on_the_line(name: str) -> None:
    vector = VECTORS[name]
    line = bytes.fromhex(vector["line"])
    assert slip_encode(packet_of(vector)) == line
    assert SlipDecoder(1024).receive(line, 5) == [FrameReceived(packet_of(vector), 5)]
    assert reference_decoder.slip_frames(line) == [packet_of(vector)]


def test_the_vectors_cover_every_service() -> None:
    services = {(vector["kind"], packet_of(vector)[7]) for vector in VECTORS.values()}
    assert services >= {("TC", number) for number in (3, 5, 6, 8, 9, 17, 20)}
    assert services >= {("TM", number) for number in (1, 3, 5, 6, 9, 13, 17, 20, 130)}
