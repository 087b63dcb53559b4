"""Cyclic frames and identifiers, against golden frames by hand and a second codec of whole numbers."""

from __future__ import annotations

import ast
import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.vectors import reference_can_frames as reference
from st_emulator.protocol.can.cyclic import (
    CAN_MESSAGES,
    CAN_MESSAGES_BY_NAME,
    IDENTIFIER_NAMES,
    CanIdentifiers,
    CanMessage,
    Signal,
    decode_can_message,
    default_bases,
    encode_can_message,
    highest_base,
)
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.protocol.pus.enumerations import CanState, Mode, Reason

FILE = Path(__file__).parents[1] / "vectors" / "golden_can_frames.json"
VECTORS = {vector["name"]: vector for vector in json.loads(FILE.read_text())["vectors"]}
EACH_VECTOR = pytest.mark.parametrize("vector", VECTORS.values(), ids=VECTORS)
EACH_MESSAGE = pytest.mark.parametrize("message", CAN_MESSAGES, ids=lambda message: message.name)


def golden_bytes(vector: dict[str, Any]) -> bytes:
    digits = "".join(part["bits"].replace(" ", "") for part in vector["bits"])
    assert len(digits) % 8 == 0
    return int(digits, 2).to_bytes(len(digits) // 8, "big")


@EACH_VECTOR
def test_golden_frame(vector: dict[str, Any]) -> None:
    assert all(part["origin"] for part in vector["bits"])
    data = golden_bytes(vector)
    decoded = vector["values"] | vector["decoded"]
    assert reference.decode(vector["frame"], data) == decoded
    assert encode_can_message(vector["frame"], vector["values"]).hex(" ") == data.hex(" ")
    assert decode_can_message(vector["frame"], data) == decoded


def test_golden_frames_show_every_frame_once() -> None:
    assert sorted(vector["frame"] for vector in VECTORS.values()) == sorted(CAN_MESSAGES_BY_NAME)


def test_the_reference_is_independent() -> None:
    tree = ast.parse(Path(reference.__file__).read_text())
    assert not [node for node in ast.walk(tree) if isinstance(node, (ast.Import, ast.ImportFrom))]


def test_the_reference_has_the_same_frames() -> None:
    assert list(reference.FRAMES) == [message.name for message in CAN_MESSAGES]
    for message in CAN_MESSAGES:
        named = [(signal.name, signal.signed, signal.bits) for signal in message.signals]
        expected = [("reserved" if n == "-" else n, s, b) for n, s, b, _ in reference.signals(message.name)]
        assert named == expected


@EACH_MESSAGE
def test_a_frame_fits_into_classic_can(message: CanMessage) -> None:
    assert sum(signal.bits for signal in message.signals) == 8 * message.size_bytes
    assert 1 <= message.size_bytes <= 8
    names = [signal.name for signal in message.carried]
    assert len(set(names)) == len(names)
    assert message.meaning
    assert all(signal.meaning for signal in message.carried)


# -- values


def expected_raw(signal: Signal, value: float) -> int:
    """The nearest step, ties to even, in exact arithmetic."""
    low, high = (
        (-(2 ** (signal.bits - 1)), 2 ** (signal.bits - 1) - 1)
        if signal.signed
        else (
            0,
            2**signal.bits - 1,
        )
    )
    steps = Fraction(value) / Fraction(signal.scale)
    return max(low, min(high, round(steps)))


def values_of(signal: Signal) -> st.SearchStrategy[float]:
    """Mostly within the range, with its ends, half steps and what is far outside."""
    low, high = signal.limits
    span = high - low
    steps = st.integers(*signal.raw_limits)
    return st.one_of(
        st.floats(low, high),
        steps.map(lambda raw: raw * signal.scale),
        steps.map(lambda raw: (raw + 0.5) * signal.scale),
        st.floats(low - span, high + span),
        st.floats(allow_nan=False, allow_infinity=False),
        st.integers(-(2**80), 2**80),
    )


@EACH_MESSAGE
@given(data=st.data())
def test_values_are_rounded_to_the_nearest_step_and_stop_at_the_ends(
    message: CanMessage, data: st.DataObject
) -> None:
    values = {signal.name: data.draw(values_of(signal)) for signal in message.carried}
    encoded = encode_can_message(message.name, values)
    raw = {signal.name: expected_raw(signal, values[signal.name]) for signal in message.carried}
    assert encoded == reference.encode(message.name, raw)
    decoded = decode_can_message(message.name, encoded)
    assert decoded == {signal.name: raw[signal.name] * signal.scale for signal in message.carried}
    assert decoded == reference.decode(message.name, encoded)


@EACH_MESSAGE
@given(data=st.data())
def test_any_bits_decode_and_come_back_but_for_the_reserved_ones(
    message: CanMessage, data: st.DataObject
) -> None:
    received = data.draw(st.binary(min_size=message.size_bytes, max_size=message.size_bytes))
    values = decode_can_message(message.name, received)
    assert values is not None
    assert values == reference.decode(message.name, received)
    ones = reference.encode(message.name, {signal.name: -1 for signal in message.carried})
    kept = bytes(byte & mask for byte, mask in zip(received, ones, strict=True))
    assert encode_can_message(message.name, values) == kept


def test_plain_numbers_come_back_as_ints_and_scaled_ones_as_floats() -> None:
    values = decode_can_message("mid_exposure_time", bytes(8))
    assert values is not None
    assert [type(values[name]) for name in ("counter", "seconds", "fraction")] == [int, int, float]


def test_enumerations_flags_and_numpy_numbers_may_be_put_in() -> None:
    status = {
        "counter": np.uint8(7),
        "mode": Mode.TRACKING,
        "valid": True,
        "rate_valid": np.bool_(False),
        "late": 0,
        "time_set": 1,
        "reasons": Reason.BLINDED | Reason.NO_MATCH,
        "stars_identified": np.int64(12),
        "spots_detected": np.float32(13.0),
        "frames_dropped_before": 0,
    }
    assert decode_can_message("status", encode_can_message("status", status)) == {
        **status,
        "reasons": 6,
        "mode": 4,
    }
    # The enumerations fit their bits.
    assert max(CanState) < 4
    assert sum(Reason) < 1 << 16


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "1", b"1", None, [1], 1j])
def test_what_is_no_finite_number_is_refused(value: Any) -> None:
    fields = {"counter": 0, "q_x": value, "q_y": 0.0}
    with pytest.raises(LocalProtocolError, match=r"attitude_1: q_x = .*; allowed: a number, -1\.\.0\.99"):
        encode_can_message("attitude_1", fields)


@pytest.mark.parametrize("value", [1e308, 10**400, 2**27, 1.0])
def test_what_is_too_large_is_the_highest(value: float) -> None:
    for sign, expected in ((1, 1 - 2**-27), (-1, -1.0)):
        decoded = decode_can_message(
            "attitude_1", encode_can_message("attitude_1", {"counter": sign, "q_x": sign * value, "q_y": 0})
        )
        assert decoded == {"counter": max(sign, 0), "q_x": expected, "q_y": 0.0}


def test_signals_must_be_those_of_the_frame() -> None:
    with pytest.raises(LocalProtocolError, match="attitude_1: q_y = None"):
        encode_can_message("attitude_1", {"counter": 0, "q_x": 0.0})
    with pytest.raises(LocalProtocolError, match="attitude_1: q_z = 1; allowed: only counter, q_x, q_y"):
        encode_can_message("attitude_1", {"counter": 0, "q_x": 0, "q_y": 0, "q_z": 1})
    with pytest.raises(LocalProtocolError, match="rates: reserved = 0"):
        encode_can_message(
            "rates", {"counter": 0, "rate_valid": 0, "reserved": 0, "rate_x": 0, "rate_y": 0, "rate_z": 0}
        )
    for work in (lambda: encode_can_message("attitude", {}), lambda: decode_can_message("telemetry", b"")):
        with pytest.raises(LocalProtocolError, match="allowed: one of heartbeat, attitude_1"):
            work()


@EACH_MESSAGE
def test_a_wrong_length_is_no_frame(message: CanMessage) -> None:
    for length in range(65):
        decoded = decode_can_message(message.name, bytes(length))
        right = length == message.size_bytes or (message.name == "sync" and length == 0)
        assert (decoded is not None) == right, length


def test_an_empty_sync_counts_as_0() -> None:
    assert decode_can_message("sync", b"") == {"sync_counter": 0}


# -- identifiers


@pytest.mark.parametrize("node", [1, 10, 127])
def test_default_identifiers(node: int) -> None:
    identifiers = CanIdentifiers(node)
    assert {name: identifiers.identifier(name) for name in IDENTIFIER_NAMES} == {
        name: reference.identifier(name, node) for name in reference.BASES
    }
    assert identifiers.telecommand == 0x600 + node
    assert identifiers.telemetry == 0x580 + node


@pytest.mark.parametrize(("extended", "bits"), [(False, 11), (True, 29)])
def test_127_nodes_share_a_bus(extended: bool, bits: int) -> None:
    own: set[int] = set()
    for node in range(1, 128):
        identifiers = CanIdentifiers(node, extended)
        for name in IDENTIFIER_NAMES:
            number = identifiers.identifier(name)
            assert 0 <= number < 1 << bits
            assert identifiers.name_of(number) == name
            assert identifiers.name_of(number, extended) == name
            assert identifiers.name_of(number, not extended) is None
            if name not in ("sync", "time_at_sync"):
                assert number not in own
                own.add(number)
    assert CanIdentifiers(1, extended).identifier("sync") not in own
    assert CanIdentifiers(1, extended).name_of(CanIdentifiers(2, extended).telemetry) is None


def test_29_bits_keep_the_order_of_priority() -> None:
    short, long = default_bases(False), default_bases(True)
    assert [base << 18 for base in short.values()] == list(long.values())
    assert list(short.values()) == sorted(short.values())


def test_identifiers_that_cannot_be_are_refused() -> None:
    for node in (0, 128, -1):
        with pytest.raises(LocalProtocolError, match=r"node = .*1\.\.127"):
            CanIdentifiers(node)
    bases = default_bases(False)
    wrong = [bases | {"sync": 0x81}, bases | {"rates": -128}, bases | {"rates": 0x800}]
    for table in wrong:
        with pytest.raises(LocalProtocolError, match="multiples of 128 up to 0x780"):
            CanIdentifiers(1, False, table)
    with pytest.raises(LocalProtocolError, match="different bases"):
        CanIdentifiers(1, False, bases | {"rates": bases["status"]})
    with pytest.raises(LocalProtocolError, match="one each of sync"):
        CanIdentifiers(1, False, {"sync": 0x80})
    with pytest.raises(LocalProtocolError, match="one of sync"):
        CanIdentifiers(1).identifier("image")
    assert highest_base(True) == 0x1FFFFF80


def test_identifiers_compare_and_hash_by_what_they_are() -> None:
    assert CanIdentifiers(3) == CanIdentifiers(3, False, default_bases(False))
    assert len({CanIdentifiers(3), CanIdentifiers(3), CanIdentifiers(4)}) == 2
