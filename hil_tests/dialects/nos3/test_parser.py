"""Any octets, cut in any way: the same commands, each at its own last octet. The reference is client.py's."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil_tests.dialects.nos3 import client
from hil_tests.dialects.nos3.bench import cut
from st_emulator.protocol.nos3.command_parser import (
    CommandParser,
    CommandReceived,
    Malformed,
    MalformedReason,
    parse_command,
)

HOUSEKEEPING = bytes.fromhex("dead 01 00000000 beef")

# Octets that the framing cares for are much more frequent than among random ones.
PIECES = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([b"\xde", b"\xad", b"\xbe", b"\xef", b"\xde\xad", b"\xbe\xef", b"\xde\xde\xad", b"\x00"]),
    st.builds(client.raw_command, st.integers(0, 255), st.integers(0, 2**32 - 1)),
    st.builds(client.raw_command, st.sampled_from([0xDE, 0xBE]), st.sampled_from([0xDEADBEEF, 0xADBEEFDE])),
    st.builds(lambda c, n: c[:n], st.builds(client.raw_command, st.integers(0, 3)), st.integers(0, 9)),
    st.builds(lambda n: client.raw_command(1)[n:], st.integers(0, 9)),
)
STREAMS = st.lists(PIECES, max_size=12).map(b"".join)
CUTS = st.lists(st.integers(0, 100), max_size=12)


def received(parser: CommandParser, piece: bytes) -> list[bytes]:
    return [event.raw for event in parser.receive(piece) if isinstance(event, CommandReceived)]


@settings(max_examples=400)
@given(STREAMS, CUTS)
@example(HOUSEKEEPING + HOUSEKEEPING, [9])
@example(b"\xde\xad\x01\x00\x00" + HOUSEKEEPING, [3, 7])
@example(b"\xde" + HOUSEKEEPING, [1, 2])
# A command inside of octets that are none, and one whose payload is the beginning of another
@example(bytes.fromhex("dead 01 dead 02 0000 0000 beef"), [])
@example(bytes.fromhex("dead 01 dead beef beef dead 02 0000 0000 beef"), [])
def test_every_cut_gives_the_commands_of_the_reference_each_at_its_last_octet(octets, cuts):
    reference = client.commands_in(octets)
    parser = CommandParser()
    behind = 0
    found: list[bytes] = []
    for piece in cut(octets, [min(place, len(octets)) for place in cuts]):
        behind += len(piece)
        found += received(parser, piece)
        assert found == [nine for end, nine in reference if end <= behind]


@settings(max_examples=300)
@given(STREAMS, CUTS)
def test_every_cut_gives_the_same_events_and_discards_the_same(octets, cuts):
    whole, pieces = CommandParser(), CommandParser()
    events = whole.receive(octets)
    parts = cut(octets, [min(place, len(octets)) for place in cuts])
    assert list(itertools.chain.from_iterable(map(pieces.receive, parts))) == events
    assert pieces.discarded == whole.discarded
    # Nothing is lost: an octet belongs to a command, is discarded, or may still begin one.
    kept = len(octets) - whole.discarded - 9 * len(client.commands_in(octets))
    assert 0 <= kept < 9


@settings(max_examples=300)
@given(st.binary(max_size=40), st.integers(0, 255), st.integers(0, 2**32 - 1))
def test_a_command_behind_garbage_is_found(garbage, number, payload):
    command = client.raw_command(number, payload)
    if any(0 < end - len(garbage) < 9 for end, _ in client.commands_in(garbage + command)):
        return  # the garbage made a command with the first octets of this one
    assert received(CommandParser(), garbage + command)[-1:] == [command]


@given(st.binary(max_size=30))
def test_nothing_is_a_command_that_lacks_header_or_trailer(octets):
    for event in CommandParser().receive(octets):
        assert len(event.raw) == 9
        assert event.raw[:2] == b"\xde\xad"
        assert isinstance(event, CommandReceived) == (event.raw[7:] == b"\xbe\xef")


def test_octet_by_octet():
    parser = CommandParser()
    *before, last = [parser.receive(HOUSEKEEPING[n : n + 1]) for n in range(9)]
    assert before == [[]] * 8
    assert last == [CommandReceived(HOUSEKEEPING, 1, 0)]


@pytest.mark.parametrize(
    "garbage", ["00", "de", "ad", "dead", "de de", "beef", "dead01000000", "dead 02 0000"]
)
def test_with_garbage_before_between_and_behind(garbage):
    data = client.command("data")
    junk = bytes.fromhex(garbage)
    parser = CommandParser()
    assert received(parser, junk + HOUSEKEEPING + junk + data + junk) == [HOUSEKEEPING, data]
    assert received(parser, HOUSEKEEPING) == [HOUSEKEEPING]


def test_a_wrong_trailer_is_told_once_and_hides_nothing():
    good = bytes.fromhex("dead 00 00000000 beef")
    parser = CommandParser()
    events = parser.receive(b"\xde\xad\x01" + good)
    assert events == [
        Malformed(bytes.fromhex("dead01dead00000000"), MalformedReason.TRAILER),
        CommandReceived(good, 0, 0),
    ]
    assert parser.discarded == 3


def test_reset_forgets_half_a_command():
    parser = CommandParser()
    parser.receive(HOUSEKEEPING[:5])
    parser.reset()
    assert received(parser, HOUSEKEEPING[5:]) == []
    assert received(parser, HOUSEKEEPING) == [HOUSEKEEPING]


def test_memory_is_bounded():
    parser = CommandParser()
    for _ in range(1000):
        parser.receive(b"\xde\xad" * 50)
    assert len(parser._octets) < 9
    assert parser.discarded > 100_000 - 9


@pytest.mark.parametrize(
    ("octets", "reason"),
    [
        ("", MalformedReason.LENGTH),
        ("dead 01 00000000 be", MalformedReason.LENGTH),
        ("dead 01 00000000 beef 00", MalformedReason.LENGTH),
        ("dead 01 00000000 beef dead 01 00000000 beef", MalformedReason.LENGTH),
        ("deac 01 00000000 beef", MalformedReason.HEADER),
        ("adde 01 00000000 beef", MalformedReason.HEADER),
        ("dead 01 00000000 beee", MalformedReason.TRAILER),
        ("dead 01 00000000 efbe", MalformedReason.TRAILER),
    ],
)
def test_one_call_of_the_reference_simulator(octets, reason):
    raw = bytes.fromhex(octets)
    assert parse_command(raw) == Malformed(raw, reason)


@given(st.integers(0, 255), st.integers(0, 2**32 - 1))
def test_one_call_with_a_command(number, payload):
    raw = client.raw_command(number, payload)
    assert parse_command(raw) == CommandReceived(raw, number, payload)
