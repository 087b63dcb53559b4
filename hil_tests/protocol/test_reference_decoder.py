"""Every message against the second implementation of the format (`struct` only)."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.protocol.message_strategies import message_fields
from hil_tests.vectors import reference_decoder
from st_emulator.protocol import (
    REGISTRY,
    CucTime,
    MessageDefinition,
    Telecommand,
    encode_image_header,
    encode_telecommand,
    encode_telemetry,
    parse_telecommand,
)


def as_reference(value: Any) -> Any:
    """Times as pairs, as the reference has them."""
    if isinstance(value, CucTime):
        return (value.coarse, value.fine)
    if isinstance(value, dict):
        return {name: as_reference(item) for name, item in value.items()}
    if isinstance(value, list):
        return [as_reference(item) for item in value]
    return value


def test_the_reference_is_independent() -> None:
    tree = ast.parse(Path(reference_decoder.__file__).read_text())
    imported = {
        alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
    } | {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported == {"struct"}
    assert "struct" in sys.stdlib_module_names


def test_the_reference_knows_every_message() -> None:
    assert {name: key for key, (name, _) in reference_decoder.TELEMETRY.items()} == {
        message.name: (message.service, message.subservice) for message in REGISTRY.telemetry()
    }
    assert {name: entry[:2] for name, entry in reference_decoder.TELECOMMANDS.items()} == {
        message.name: (message.service, message.subservice) for message in REGISTRY.telecommands()
    }


@pytest.mark.parametrize("message", REGISTRY.telemetry(), ids=lambda message: message.name)
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_the_reference_reads_our_telemetry(message: MessageDefinition, data: st.DataObject) -> None:
    fields = data.draw(message_fields(message))
    count, destination = data.draw(st.integers(0, 65535)), data.draw(st.integers(0, 65535))
    time = data.draw(st.builds(CucTime, st.integers(0, 2**32 - 1), st.integers(0, 2**24 - 1)))
    raw = encode_telemetry(
        message.name,
        fields,
        apid=321,
        sequence_count=12345,
        message_count=count,
        destination_id=destination,
        time=time,
        time_status=1,
    )
    assert reference_decoder.decode_telemetry(raw) == {
        "version": 0,
        "packet_type": 0,
        "secondary_header": 1,
        "apid": 321,
        "sequence_flags": 3,
        "sequence_count": 12345,
        "pus_version": 2,
        "time_status": 1,
        "service": message.service,
        "subservice": message.subservice,
        "message_count": count,
        "destination_id": destination,
        "time": as_reference(time),
        "name": message.name,
        "fields": as_reference(fields),
    }


@pytest.mark.parametrize("message", REGISTRY.telecommands(), ids=lambda message: message.name)
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_we_read_the_telecommands_of_the_reference(message: MessageDefinition, data: st.DataObject) -> None:
    fields = data.draw(message_fields(message))
    header = {
        "apid": data.draw(st.integers(0, 2046)),
        "sequence_count": data.draw(st.integers(0, 16383)),
        "source_id": data.draw(st.integers(0, 65535)),
        "ack": data.draw(st.integers(0, 15)),
    }
    raw = reference_decoder.encode_telecommand(message.name, as_reference(fields), **header)
    packet = parse_telecommand(raw)
    assert isinstance(packet, Telecommand), packet
    assert (packet.name, packet.fields) == (message.name, fields)
    assert {name: getattr(packet, name) for name in header} == header
    assert encode_telecommand(message.name, fields, **header) == raw


def test_the_reference_reads_our_image_header() -> None:
    fields = {
        "frame_index": 1,
        "width": 2,
        "height": 3,
        "bits": 4,
        "reserved": 0,
        "time": CucTime(5, 6),
        "exposure_us": 7,
        "crc": 8,
    }
    assert reference_decoder.decode_image_header(encode_image_header(fields)) == as_reference(fields)
