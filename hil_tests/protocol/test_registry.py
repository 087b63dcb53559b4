"""The registry: every message survives the wire; every value outside its range is named and refused."""

from __future__ import annotations

import math
from enum import IntFlag
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.protocol.message_strategies import message_fields, smallest_fields
from st_emulator.protocol import (
    EVENTS,
    FUNCTIONS,
    HOUSEKEEPING,
    MEANINGS,
    PARAMETERS,
    PARAMETERS_BY_NAME,
    REGISTRY,
    CucTime,
    EventId,
    Field,
    FieldProblem,
    FunctionId,
    HousekeepingId,
    LocalProtocolError,
    Malformed,
    MessageDefinition,
    MessageRegistry,
    ParameterId,
    Repeated,
    RequestId,
    Switched,
    Telecommand,
    Telemetry,
    decode_image_header,
    encode_image_header,
    encode_telecommand,
    encode_telemetry,
    field_violation,
    parse_telecommand,
    parse_telemetry,
)
from st_emulator.protocol.errors import RemoteProtocolError
from st_emulator.protocol.pus import enumerations

TM_HEADER: dict[str, Any] = {
    "apid": 100,
    "sequence_count": 1,
    "message_count": 2,
    "destination_id": 3,
    "time": CucTime(4, 5),
    "time_status": 1,
}

# The numbers of the interface, written by hand: changing one of them breaks every OBC that knows it.
TYPES = """
TM 1 1 acceptance_success    TM 1 2 acceptance_failure   TM 1 3 start_success      TM 1 4 start_failure
TM 1 5 progress              TM 1 6 progress_failure     TM 1 7 completion_success TM 1 8 completion_failure
TM 1 10 routing_failure
TC 3 5 hk_enable             TC 3 6 hk_disable           TC 3 27 hk_one_shot       TC 3 31 hk_set_interval
TM 3 25 hk_report
TM 5 1 event_info            TM 5 2 event_low            TM 5 3 event_medium       TM 5 4 event_high
TC 5 5 event_enable          TC 5 6 event_disable        TC 5 7 event_report_disabled
TM 5 8 event_disabled_list
TC 6 2 memory_load           TC 6 5 memory_dump          TC 6 9 memory_check
TM 6 6 memory_dump_report    TM 6 10 memory_check_report
TC 8 1 function
TC 9 1 time_report_rate      TM 9 2 time_report          TC 9 128 set_time
TM 13 1 image_first_part     TM 13 2 image_part          TM 13 3 image_last_part
TC 17 1 ping                 TM 17 2 pong
TC 20 1 parameter_report     TM 20 2 parameter_values    TC 20 3 parameter_set
TM 130 1 attitude_report
"""


def encode(message: MessageDefinition, fields: dict[str, Any], **options: Any) -> bytes:
    if message.kind == "TC":
        return encode_telecommand(message.name, fields, apid=100, sequence_count=1, **options)
    return encode_telemetry(message.name, fields, **TM_HEADER)


def parse(message: MessageDefinition, raw: bytes) -> Telecommand | Telemetry | Malformed:
    return parse_telecommand(raw) if message.kind == "TC" else parse_telemetry(raw)


ALL = pytest.mark.parametrize("message", REGISTRY, ids=lambda message: message.name)


def test_types_are_those_of_the_interface() -> None:
    words = TYPES.split()
    expected = {
        (words[n], int(words[n + 1]), int(words[n + 2])): words[n + 3] for n in range(0, len(words), 4)
    }
    assert {(m.kind, m.service, m.subservice): m.name for m in REGISTRY} == expected


@ALL
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_every_message_survives_the_wire(message: MessageDefinition, data: st.DataObject) -> None:
    fields = data.draw(message_fields(message))
    raw = encode(message, fields)
    packet = parse(message, raw)
    assert not isinstance(packet, Malformed), packet
    assert (packet.name, packet.service, packet.subservice) == (
        message.name,
        message.service,
        message.subservice,
    )
    assert packet.fields == fields
    assert packet.raw == raw
    assert field_violation(packet) is None
    assert encode(message, packet.fields) == raw
    assert_plain(packet.fields)


def assert_plain(value: Any) -> None:
    """Only plain Python types, exactly, so that anybody may print, store or compare them."""
    assert type(value) in (dict, list, int, float, bytes, CucTime), type(value)
    if isinstance(value, dict):
        assert all(type(key) is str for key in value)
        for item in value.values():
            assert_plain(item)
    if isinstance(value, list):
        for item in value:
            assert_plain(item)


@ALL
def test_every_definition_says_what_it_is(message: MessageDefinition) -> None:
    assert REGISTRY.by_name(message.name) is message
    assert REGISTRY.by_type(message.kind, message.service, message.subservice) is message
    assert message.title
    assert message.description.endswith(".")
    assert message.clause or message.tailoring.startswith("Mission-specific")
    if message.kind == "TC":
        assert message.verification
    names = [element.name for element in message.fields]
    assert len(set(names)) == len(names)
    for field in walk(message.fields):
        assert field.meaning, field
        assert field.name == field.name.lower()


def walk(elements: tuple[Any, ...]) -> list[Field]:
    found: list[Field] = []
    for element in elements:
        if isinstance(element, Field):
            found.append(element)
        elif isinstance(element, Repeated):
            found += walk(element.items)
        elif isinstance(element, Switched):
            for case in element.cases.values():
                found += walk(case.fields)
    return found


def test_every_identifier_has_its_definition() -> None:
    assert set(EVENTS) == {int(member) for member in EventId}
    assert set(FUNCTIONS) == {int(member) for member in FunctionId}
    assert set(PARAMETERS) == {int(member) for member in ParameterId}
    assert set(HOUSEKEEPING) == {int(member) for member in HousekeepingId}
    for event in EVENTS.values():
        message = REGISTRY.by_name(event.message_name)
        switched = message.fields[1]
        assert isinstance(switched, Switched)
        assert switched.cases[int(event.id)].fields == event.fields


def test_every_enumeration_member_has_a_meaning_of_its_own() -> None:
    defined_elsewhere = (EventId, FunctionId, ParameterId)
    for kind in vars(enumerations).values():
        if not (
            isinstance(kind, type) and issubclass(kind, int) and kind.__module__ == enumerations.__name__
        ):
            continue
        for member in kind:
            assert (member in MEANINGS) == (kind not in defined_elsewhere), member
    # Members of different enumerations are equal as numbers and must not share a meaning.
    assert MEANINGS[enumerations.Mode.BOOT] != MEANINGS[enumerations.TimeStatus.FREE_RUNNING]
    assert MEANINGS.get(EventId.TIME_SET) is None
    assert len(MEANINGS) == len(list(MEANINGS))


def test_a_name_or_type_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="defined twice"):
        MessageRegistry([*REGISTRY.services, REGISTRY.services[0]])


# --- values that are not allowed ---


def single_fields() -> list[tuple[MessageDefinition, Field]]:
    return [(m, f) for m in REGISTRY for f in m.fields if isinstance(f, Field)]


@pytest.mark.parametrize(
    ("message", "field"), single_fields(), ids=lambda entry: getattr(entry, "name", str(entry))
)
def test_every_limit_is_held(message: MessageDefinition, field: Field) -> None:
    fields = smallest_fields(message)
    encode(message, fields)
    wrong: list[Any] = [None, "text", [1]]
    if field.type.kind == "integer":
        low, high = field.limits()
        wrong += [low - 1, high + 1, 0.5, math.nan]
        if field.choices is not None and not issubclass(field.choices, IntFlag):
            wrong += [max(field.choices) + 1]
    elif field.type.kind == "float" and field.minimum is not None and field.maximum is not None:
        wrong += [field.minimum - 1e-3, field.maximum + 1e-3, math.nan, math.inf]
    elif field.type.kind == "float" and field.type.size_bytes == 4:
        wrong += [1e39, -1e39]
    elif field.type.kind == "time":
        wrong += [0, bytes(7)]
    elif field.type.kind == "request_id":
        wrong += [0, {}, dict(RequestId().as_fields(), apid=2048), dict(RequestId().as_fields(), apid="x")]
    for value in wrong:
        with pytest.raises(LocalProtocolError) as caught:
            encode(message, fields | {field.name: value})
        assert caught.value.message == message.name
        assert caught.value.field.split(".")[0] == field.name
        assert caught.value.allowed
        assert message.name in str(caught.value)


@ALL
def test_missing_and_unexpected_fields_are_refused(message: MessageDefinition) -> None:
    fields = smallest_fields(message)
    with pytest.raises(LocalProtocolError) as caught:
        encode(message, fields | {"surprise": 1})
    assert caught.value.field == "surprise"
    for element in message.fields:
        rest = {name: value for name, value in fields.items() if name != element.name}
        if isinstance(element, Switched):
            continue
        with pytest.raises(LocalProtocolError) as caught:
            encode(message, rest)
        assert caught.value.field == element.name
        assert caught.value.value is None


@pytest.mark.parametrize(
    ("name", "fields", "path", "allowed"),
    [
        ("hk_enable", {"structure_ids": []}, "structure_ids", "1..16 items"),
        ("hk_enable", {"structure_ids": [1] * 17}, "structure_ids", "1..16 items"),
        ("hk_enable", {"structure_ids": 1}, "structure_ids", "a list of 1..16 items"),
        ("hk_enable", {"structure_ids": "12"}, "structure_ids", "a list of 1..16 items"),
        (
            "hk_enable",
            {"structure_ids": [1, 9]},
            "structure_ids[1]",
            "one of 1 STATUS, 2 LINK, 3 TIMING, 4 CAN",
        ),
        (
            "hk_set_interval",
            {"intervals": [{"structure_id": 1, "interval_ms": 249}]},
            "intervals[0].interval_ms",
            "250..3600000",
        ),
        ("hk_set_interval", {"intervals": [{"structure_id": 1}]}, "intervals[0].interval_ms", "250..3600000"),
        ("hk_set_interval", {"intervals": [1]}, "intervals[0]", "a dict"),
        ("function", {"function_id": 4, "arguments": {"kind": 2}}, "arguments.kind", "one of 0 WARM, 1 COLD"),
        ("function", {"function_id": 4}, "arguments.kind", "one of 0 WARM, 1 COLD"),
        ("function", {"function_id": 4, "arguments": 1}, "arguments", "a dict"),
        ("function", {"function_id": 1, "arguments": {"kind": 0}}, "arguments.kind", "no fields"),
        (
            "parameter_set",
            {"settings": [{"parameter_id": 1, "value": 99}]},
            "settings[0].value",
            "100..250000",
        ),
        ("parameter_set", {"settings": [{"parameter_id": 1}]}, "settings[0].value", "100..250000"),
        (
            "memory_load",
            {"memory_id": 1, "start_address": 0, "data": "x", "checksum": 0},
            "data",
            "1..256 octets",
        ),
        (
            "memory_load",
            {"memory_id": 1, "start_address": 0, "data": b"", "checksum": 0},
            "data",
            "1..256 octets",
        ),
        ("time_report_rate", {"rate_exponent": 9}, "rate_exponent", "0..8"),
    ],
)
def test_errors_name_the_path_and_what_is_allowed(
    name: str, fields: dict[str, Any], path: str, allowed: str
) -> None:
    with pytest.raises(LocalProtocolError) as caught:
        encode_telecommand(name, fields, apid=1, sequence_count=0)
    assert (caught.value.message, caught.value.field, caught.value.allowed) == (name, path, allowed)


def test_fields_must_be_a_dict() -> None:
    with pytest.raises(LocalProtocolError, match="ping: fields = 7; allowed: a dict"):
        encode_telecommand("ping", 7, apid=1, sequence_count=0)  # type: ignore[arg-type]


def test_an_event_goes_only_into_the_report_of_its_severity() -> None:
    with pytest.raises(
        LocalProtocolError, match="event_info: event_id = 13; allowed: one of 1 BOOT_COMPLETED"
    ):
        encode_telemetry("event_info", {"event_id": 13, "data": {"cause": 1}}, **TM_HEADER)


@pytest.mark.parametrize("name", ["pong", "nothing"])
def test_only_telecommands_are_encoded_as_telecommands(name: str) -> None:
    with pytest.raises(
        LocalProtocolError, match=rf"telecommand: name = '{name}'; allowed: one of hk_enable, "
    ):
        encode_telecommand(name, {}, apid=1, sequence_count=0)
    with pytest.raises(
        LocalProtocolError, match="telemetry: name = 'ping'; allowed: one of acceptance_success, "
    ):
        encode_telemetry("ping", {}, **TM_HEADER)


def test_long_values_are_cut_in_the_message() -> None:
    with pytest.raises(LocalProtocolError) as caught:
        encode_telecommand("ping", {"surprise": "x" * 1000}, apid=1, sequence_count=0)
    assert len(str(caught.value)) < 200


# --- convenience and plain values ---


def test_enumerations_and_numpy_scalars_are_taken_as_numbers() -> None:
    message = REGISTRY.by_name("attitude_report")
    plain = smallest_fields(message) | {"valid": 1, "mode": 4, "q_w": 1.0, "stars_identified": 7}
    other = plain | {
        "valid": np.bool_(True),
        "mode": enumerations.Mode.TRACKING,
        "q_w": np.float64(1.0),
        "stars_identified": np.int64(7),
    }
    assert encode(message, other) == encode(message, plain)


def test_empty_arguments_may_be_left_out() -> None:
    raw = encode_telecommand("function", {"function_id": FunctionId.GO_STANDBY}, apid=1, sequence_count=0)
    packet = parse_telecommand(raw)
    assert isinstance(packet, Telecommand)
    assert packet.fields == {"function_id": 1, "arguments": {}}


def test_a_request_id_may_be_given_as_such() -> None:
    request_id = RequestId(apid=100, sequence_count=77)
    as_object = encode_telemetry("start_success", {"request_id": request_id}, **TM_HEADER)
    as_fields = encode_telemetry("start_success", {"request_id": request_id.as_fields()}, **TM_HEADER)
    assert as_object == as_fields
    packet = parse_telemetry(as_object)
    assert isinstance(packet, Telemetry)
    assert RequestId.from_fields(packet.fields["request_id"]) == request_id


def test_nan_and_infinity_pass_where_a_float_has_no_limits() -> None:
    message = REGISTRY.by_name("attitude_report")
    raw = encode(message, smallest_fields(message) | {"noise_dn": math.nan, "rate_x": -math.inf})
    packet = parse_telemetry(raw)
    assert isinstance(packet, Telemetry)
    assert math.isnan(packet.fields["noise_dn"])
    assert packet.fields["rate_x"] == -math.inf


@pytest.mark.parametrize("parameter", PARAMETERS.values(), ids=lambda parameter: parameter.name)
def test_the_limits_of_a_parameter_may_be_set(parameter: Any) -> None:
    """Also those that a 32-bit float cannot hold exactly, such as 0.01."""
    assert PARAMETERS_BY_NAME[parameter.name] is parameter
    for value in (parameter.minimum, parameter.maximum):
        fields = {"settings": [{"parameter_id": int(parameter.id), "value": value}]}
        packet = parse_telecommand(encode_telecommand("parameter_set", fields, apid=1, sequence_count=0))
        assert isinstance(packet, Telecommand)
        carried = packet.fields["settings"][0]["value"]
        assert carried == pytest.approx(value, rel=1e-7)
        assert field_violation(packet) is None
        assert parameter.violation(carried) is None
        assert parameter.as_carried(value) == carried
    below = parameter.violation(parameter.minimum - (0.5 if parameter.type.kind == "float" else 1))
    assert below is not None
    assert below.problem is FieldProblem.OUT_OF_RANGE
    assert str(below).startswith(f"{parameter.name} = ")
    with pytest.raises(LocalProtocolError, match=f"parameter: {parameter.name} = "):
        parameter.as_carried(parameter.maximum * 2 + 1)


# --- the image header ---


def test_image_header_survives() -> None:
    fields = {
        "frame_index": 9,
        "width": 1024,
        "height": 768,
        "bits": 12,
        "reserved": 0,
        "time": CucTime(1, 2),
        "exposure_us": 200_000,
        "crc": 0xABCD,
    }
    raw = encode_image_header(fields)
    assert raw.hex() == "00000009" + "0400" + "0300" + "0c" + "00" + "00000001000002" + "00030d40" + "abcd"
    assert decode_image_header(raw + bytes(100)) == fields
    with pytest.raises(RemoteProtocolError, match="23 bytes, got 22"):
        decode_image_header(raw[:-1])
    with pytest.raises(LocalProtocolError, match=r"image header: bits = 17; allowed: 1..16"):
        encode_image_header(fields | {"bits": 17})
