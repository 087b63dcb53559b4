"""Values that were received and are not allowed: found, named, and given the failure code to answer with."""

from __future__ import annotations

import math
from typing import Any

import pytest

from st_emulator.protocol import (
    REGISTRY,
    FailureCode,
    FieldProblem,
    LocalProtocolError,
    Malformed,
    MalformedReason,
    Telecommand,
    encode_telecommand,
    field_violation,
    parse_telecommand,
)


@pytest.mark.parametrize(
    ("name", "fields", "path", "code"),
    [
        ("hk_enable", {"structure_ids": [1, 77]}, "structure_ids[1]", FailureCode.UNKNOWN_ID),
        ("hk_enable", {"structure_ids": []}, "structure_ids", FailureCode.OUT_OF_RANGE),
        ("event_disable", {"event_ids": [999]}, "event_ids[0]", FailureCode.UNKNOWN_ID),
        ("parameter_report", {"parameter_ids": [1, 0]}, "parameter_ids[1]", FailureCode.UNKNOWN_ID),
        (
            "parameter_set",
            {"settings": [{"parameter_id": 1, "value": 1}]},
            "settings[0].value",
            FailureCode.OUT_OF_RANGE,
        ),
        (
            "parameter_set",
            {"settings": [{"parameter_id": 2, "value": math.nan}]},
            "settings[0].value",
            FailureCode.OUT_OF_RANGE,
        ),
        (
            "function",
            {"function_id": 4, "arguments": {"kind": 9}},
            "arguments.kind",
            FailureCode.OUT_OF_RANGE,
        ),
        (
            "function",
            {"function_id": 11, "arguments": {"q_x": 0.0, "q_y": math.nan, "q_z": 0.0, "q_w": 1.0}},
            "arguments.q_y",
            FailureCode.OUT_OF_RANGE,
        ),
        (
            "memory_dump",
            {"memory_id": 9, "start_address": 0, "length": 1},
            "memory_id",
            FailureCode.UNKNOWN_ID,
        ),
        (
            "memory_dump",
            {"memory_id": 1, "start_address": 0, "length": 0},
            "length",
            FailureCode.OUT_OF_RANGE,
        ),
        (
            "memory_load",
            {"memory_id": 1, "start_address": 0, "data": bytes(257), "checksum": 0},
            "data",
            FailureCode.OUT_OF_RANGE,
        ),
        ("time_report_rate", {"rate_exponent": 200}, "rate_exponent", FailureCode.OUT_OF_RANGE),
        (
            "hk_set_interval",
            {"intervals": [{"structure_id": 1, "interval_ms": 0}]},
            "intervals[0].interval_ms",
            FailureCode.OUT_OF_RANGE,
        ),
    ],
)
def test_wrong_values_get_through_only_when_asked_for_and_are_found(
    name: str, fields: dict[str, Any], path: str, code: FailureCode
) -> None:
    with pytest.raises(LocalProtocolError):
        encode_telecommand(name, fields, apid=1, sequence_count=0)
    packet = parse_telecommand(encode_telecommand(name, fields, apid=1, sequence_count=0, strict=False))
    assert isinstance(packet, Telecommand)
    violation = field_violation(packet)
    assert violation is not None
    assert (violation.field, violation.failure_code) == (path, code)
    assert violation.allowed


def test_an_unknown_identifier_that_selects_a_layout() -> None:
    raw = encode_telecommand(
        "parameter_set",
        {"settings": [{"parameter_id": 1, "value": 200}, {"parameter_id": 500, "value": b"\x01"}]},
        apid=1,
        sequence_count=0,
        strict=False,
    )
    malformed = parse_telecommand(raw)
    assert isinstance(malformed, Malformed)
    assert malformed.reason is MalformedReason.UNKNOWN_ID
    assert malformed.reason.failure_code is FailureCode.UNKNOWN_ID
    assert malformed.detail == "parameter_set: parameter_id 500 is not known"


def test_even_when_asked_for_a_type_holds_only_what_fits() -> None:
    for fields in ({"function_id": 256}, {"function_id": 99, "arguments": 5}, {"function_id": 99}):
        with pytest.raises(LocalProtocolError):
            encode_telecommand("function", fields, apid=1, sequence_count=0, strict=False)


def test_a_missing_value_is_a_violation_of_the_layout() -> None:
    violation = REGISTRY.by_name("hk_enable").data.violation({})
    assert violation is not None
    assert violation.problem is FieldProblem.MISSING
    assert violation.failure_code is FailureCode.BAD_FIELDS
