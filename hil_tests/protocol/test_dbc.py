"""The DBC as cantools, which is not ours, reads it: every frame of the bus and every signal."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cantools
import pytest
from cantools.database.can import Database, Message
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.protocol.can.cyclic import (
    CAN_MESSAGES,
    IDENTIFIER_NAMES,
    CanIdentifiers,
    CanMessage,
    Signal,
    decode_can_message,
    default_bases,
    encode_can_message,
)
from st_emulator.protocol.can.frames import CanFrame, candump_line
from st_emulator.protocol.can.transport import IsoTpConnection, IsoTpSettings, PduReceived
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.protocol.exporters.dbc import DbcUnit, can_database

GOLDEN = Path(__file__).parents[1] / "vectors" / "golden_can_frames.json"
CYCLES = {"heartbeat": 1000, "attitude_1": 250, "attitude_2": 250, "rates": 500, "status": 0}
UNITS = (
    DbcUnit("alpha", CanIdentifiers(10), CYCLES),
    DbcUnit("beta", CanIdentifiers(11), CYCLES),
    DbcUnit("alpha", CanIdentifiers(127), CYCLES),
)
LONG = DbcUnit("alpha", CanIdentifiers(10, extended=True), CYCLES)
TEXT = can_database(UNITS)


def load(text: str) -> Database:
    database = cantools.database.load_string(text, database_format="dbc", strict=True)
    assert isinstance(database, Database)
    return database


DATABASE, LONG_DATABASE = load(TEXT), load(can_database([LONG]))
EACH = pytest.mark.parametrize("message", CAN_MESSAGES, ids=lambda message: message.name)
WIDTHS = pytest.mark.parametrize(
    ("database", "unit"), [(DATABASE, UNITS[2]), (LONG_DATABASE, LONG)], ids=["11 bits", "29 bits"]
)


def name_in(unit: DbcUnit, message: CanMessage) -> str:
    return message.name if message.broadcast else f"{unit.name}_{unit.identifiers.node}_{message.name}"


# -- what the file says


def test_it_is_the_same_each_time_and_plain_text() -> None:
    assert can_database(UNITS) == TEXT
    assert TEXT.isascii()
    assert TEXT.endswith(";\n")


def test_every_frame_of_every_unit_is_in_it_once() -> None:
    expected = {"sync": 0x080, "time_at_sync": 0x100}
    for unit in UNITS:
        for name in set(IDENTIFIER_NAMES) - set(expected):
            expected[f"{unit.node_name}_{name}"] = unit.identifiers.identifier(name)
    assert {message.name: message.frame_id for message in DATABASE.messages} == expected
    assert len(DATABASE.messages) == len(expected) == 2 + 9 * 3
    assert not any(message.is_extended_frame or message.is_fd for message in DATABASE.messages)
    assert [node.name for node in DATABASE.nodes] == ["OBC", "alpha_10", "beta_11", "alpha_127"]


def test_29_bit_identifiers() -> None:
    assert all(message.is_extended_frame for message in LONG_DATABASE.messages)
    assert LONG_DATABASE.get_message_by_name("alpha_10_rates").frame_id == (0x380 << 18) + 10
    assert LONG_DATABASE.get_message_by_name("sync").frame_id == 0x080 << 18


@WIDTHS
@EACH
def test_a_frame_as_cantools_reads_it(database: Database, unit: DbcUnit, message: CanMessage) -> None:
    read = database.get_message_by_name(name_in(unit, message))
    assert read.length == message.size_bytes
    assert read.cycle_time == (CYCLES.get(message.name) or None)
    assert read.comment == message.meaning
    if message.direction == "TM":
        assert read.senders == [unit.node_name]
        assert read.receivers == {"OBC"}
    else:
        assert read.senders == ["OBC"]
        assert read.receivers == {node.name for node in database.nodes} - {"OBC"}
    assert {signal.name for signal in read.signals} == {signal.name for signal in message.carried}
    for signal in message.carried:
        entry = read.get_signal_by_name(signal.name)
        assert (entry.length, entry.is_signed, entry.byte_order) == (signal.bits, signal.signed, "big_endian")
        assert (entry.scale, entry.offset) == (signal.scale, signal.offset)
        assert (entry.minimum, entry.maximum) == signal.limits
        assert (entry.unit or "") == signal.unit
        assert entry.comment is not None
        assert entry.comment.startswith(signal.meaning)
        if signal.choices is None:
            assert not entry.choices
        else:
            assert entry.choices is not None
            named = {number: str(name) for number, name in entry.choices.items()}
            assert named.items() >= {int(member): member.name for member in signal.choices}.items()


def test_comments_say_what_each_bit_of_the_reasons_means() -> None:
    comment = DATABASE.get_message_by_name("beta_11_status").get_signal_by_name("reasons").comment
    assert comment is not None
    assert "4 BLINDED: background above the limit" in comment


# -- values there and back


def inside(signal: Signal) -> st.SearchStrategy[float]:
    """Within the range, which ends at the highest step."""
    return st.one_of(
        st.integers(*signal.raw_limits).map(signal.physical),
        st.floats(*signal.limits) if signal.scale != 1 else st.integers(*signal.raw_limits),
        st.sampled_from(signal.limits),
    )


def drawn(message: CanMessage, data: st.DataObject) -> dict[str, float]:
    return {signal.name: data.draw(inside(signal), signal.name) for signal in message.carried}


def plain(database: Database, frame_id: int, data: bytes) -> dict[str, Any]:
    decoded = database.decode_message(frame_id, data, decode_choices=False)
    assert isinstance(decoded, dict)
    return decoded


@WIDTHS
@EACH
@given(data=st.data())
def test_cantools_reads_what_we_send(
    database: Database, unit: DbcUnit, message: CanMessage, data: st.DataObject
) -> None:
    values = drawn(message, data)
    identifier = unit.identifiers.identifier(message.name)
    decoded = plain(database, identifier, encode_can_message(message.name, values))
    assert set(decoded) == set(values)
    for signal in message.carried:
        assert abs(decoded[signal.name] - values[signal.name]) <= signal.scale / 2, signal.name
        assert math.isfinite(decoded[signal.name])


@WIDTHS
@EACH
@given(data=st.data())
def test_we_read_what_cantools_sends(
    database: Database, unit: DbcUnit, message: CanMessage, data: st.DataObject
) -> None:
    values = drawn(message, data)
    sent = database.encode_message(unit.identifiers.identifier(message.name), values, strict=True)
    decoded = decode_can_message(message.name, sent)
    assert decoded is not None
    for signal in message.carried:
        # cantools rounds a half up, we to even: both are within half a step.
        assert abs(decoded[signal.name] - values[signal.name]) <= signal.scale / 2 * (1 + 1e-9), signal.name


@EACH
def test_each_signal_alone_at_both_ends_and_beyond(message: CanMessage) -> None:
    """The others stay 0: no signal reaches into another's bits."""
    identifier = UNITS[0].identifiers.identifier(message.name)
    for signal in message.carried:
        low, high = signal.limits
        for value, expected in ((low, low), (high, high), (low - 1, low), (high + 1, high), (high * 2, high)):
            values = dict.fromkeys((entry.name for entry in message.carried), 0) | {signal.name: value}
            decoded = plain(DATABASE, identifier, encode_can_message(message.name, values))
            assert decoded == dict.fromkeys(decoded, 0) | {signal.name: expected}, (signal.name, value)


def test_negative_numbers_of_known_steps() -> None:
    identifiers = UNITS[0].identifiers
    turned = encode_can_message("attitude_1", {"counter": 3, "q_x": -0.5, "q_y": -(2.0**-27)})
    expected = {"counter": 3, "q_x": -0.5, "q_y": -(2.0**-27)}
    assert plain(DATABASE, identifiers.identifier("attitude_1"), turned) == expected
    rates = {"counter": 0, "rate_valid": 1, "rate_x": -0.25, "rate_y": -(2.0**-19), "rate_z": 0.125}
    encoded = encode_can_message("rates", rates)
    assert plain(DATABASE, identifiers.identifier("rates"), encoded) == rates


@pytest.mark.parametrize("vector", json.loads(GOLDEN.read_text())["vectors"], ids=lambda v: v["name"])
def test_cantools_reads_the_golden_frames(vector: dict[str, Any]) -> None:
    digits = "".join(part["bits"].replace(" ", "") for part in vector["bits"])
    data = int(digits, 2).to_bytes(len(digits) // 8, "big")
    identifier = UNITS[1].identifiers.identifier(vector["frame"])
    assert plain(DATABASE, identifier, data) == vector["values"] | vector["decoded"]


def test_cantools_names_modes_states_and_single_reasons() -> None:
    beat = {"counter": 0, "mode": 4, "attitude_valid": 1, "time_set": 0, "can_state": 1, "boot_count": 1}
    read = DATABASE.decode_message(
        "beta_11_heartbeat", encode_can_message("heartbeat", beat | {"uptime_s": 5})
    )
    assert isinstance(read, dict)
    assert (str(read["mode"]), str(read["can_state"])) == ("TRACKING", "ERROR_PASSIVE")
    (message,) = (message for message in CAN_MESSAGES if message.name == "status")
    status = dict.fromkeys((signal.name for signal in message.carried), 0)
    for reasons, expected in ((0, "NONE"), (2048, "NO_FRAME"), (6, "6")):
        data = encode_can_message("status", status | {"reasons": reasons})
        read = DATABASE.decode_message("beta_11_status", data)
        assert isinstance(read, dict)
        assert str(read["reasons"]) == expected


# -- packets by ISO-TP


def transfer(packet: bytes, settings: IsoTpSettings, **peer: Any) -> Iterator[CanFrame]:
    """Every frame of both directions of one transfer; the receiver answers at once."""
    sender = IsoTpConnection(settings)
    receiver = IsoTpConnection(
        IsoTpSettings(
            transmit_identifier=settings.receive_identifier,
            receive_identifier=settings.transmit_identifier,
            extended=settings.extended,
            fd=settings.fd,
            frame_bytes=settings.frame_bytes,
            padding=settings.padding,
            **peer,
        )
    )
    now_ns = 0
    sender.send(packet, now_ns)
    for _ in range(10_000):
        for one, other in ((sender, receiver), (receiver, sender)):
            frame = one.next_frame(now_ns)
            if frame is None:
                continue
            yield frame
            one.confirmed(frame, now_ns)
            for event in other.receive(frame, now_ns):
                assert isinstance(event, PduReceived), event
                assert event.data == packet
                return
        now_ns += 1_000_000
    pytest.fail("the transfer does not end")


def reassembled(database: Database, frames: list[CanFrame], telemetry: int) -> bytes:
    """The packet from the signals that cantools decodes, nothing else."""
    packet, length, counted = b"", 0, 0
    for frame in frames:
        message = database.get_message_by_frame_id(frame.identifier)
        assert isinstance(message, Message)
        read = message.decode(frame.data, decode_choices=False, allow_truncated=True)
        assert isinstance(read, dict)
        kind = read["pci_type"]
        bytes_by_place = {
            int(name.rsplit("_", 1)[1]): int(value) for name, value in read.items() if "_byte_" in name
        }
        octets = bytes(value for _, value in sorted(bytes_by_place.items()))
        if frame.identifier != telemetry:
            assert kind == 3
            assert (read["fc_status"], read["fc_block_size"], read["fc_separation_time"]) == (0, 3, 0xF2)
        elif kind == 0:
            length = int(read["sf_length"])
            packet = octets[:length] if length else octets[1 : 1 + octets[0]]
            length = len(packet)
        elif kind == 1:
            length, packet = int(read["ff_length"]), octets
        else:
            assert kind == 2
            counted += 1
            assert read["cf_sequence"] == counted % 16
            packet += octets
    return packet[:length]


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("padding", [0xCC, None])
@pytest.mark.parametrize("size", [1, 7, 8, 62, 63, 200, 4095])
@pytest.mark.parametrize("fd", [False, True])
def test_transport_frames_decode_to_the_packet(
    fd: bool, size: int, padding: int | None, extended: bool
) -> None:
    identifiers = CanIdentifiers(42, extended)
    database = load(can_database([DbcUnit("gamma", identifiers)], fd=fd))
    packet = bytes((7 * n + n // 256) % 256 for n in range(size))
    settings = IsoTpSettings(
        transmit_identifier=identifiers.telemetry,
        receive_identifier=identifiers.telecommand,
        extended=extended,
        fd=fd,
        frame_bytes=64 if fd else 8,
        padding=padding,
    )
    frames = list(transfer(packet, settings, block_size=3, separation_time_us=200))
    assert reassembled(database, frames, identifiers.telemetry) == packet
    if padding is not None and not fd:  # every frame is full: no tool needs to be told to accept short ones
        assert all(len(frame.data) == 8 for frame in frames)
        assert all(database.decode_message(frame.identifier, frame.data) for frame in frames)


def test_transport_messages_of_both_kinds_of_bus() -> None:
    for fd, length in ((False, 8), (True, 64)):
        database = load(can_database(UNITS, fd=fd))
        for name in ("alpha_10_telemetry", "alpha_10_telecommand"):
            message = database.get_message_by_name(name)
            assert (message.is_fd, message.length) == (fd, length)
            assert message.cycle_time is None
        # Cyclic frames are classic on either bus.
        assert not database.get_message_by_name("alpha_10_rates").is_fd
    message = DATABASE.get_message_by_name("beta_11_telecommand")
    assert message.senders == ["OBC"]
    assert message.receivers == {"beta_11"}
    read = DATABASE.decode_message("beta_11_telecommand", bytes([0x31, 0, 0, *[0xCC] * 5]))
    assert isinstance(read, dict)
    assert {name: str(value) for name, value in read.items()} == {
        "pci_type": "FLOW_CONTROL",
        "fc_status": "WAIT",
        "fc_block_size": "0",
        "fc_separation_time": "0",
    }


# -- a whole bus


def bus_log() -> list[tuple[str, CanFrame]]:
    """A frame of each kind of each unit, with the message's name."""
    frames = []
    for unit in UNITS:
        for message in CAN_MESSAGES:
            values = {signal.name: signal.limits[0] for signal in message.carried}
            data = encode_can_message(message.name, values)
            frames.append((name_in(unit, message), unit.identifiers.identifier(message.name), data))
        for name in ("telemetry", "telecommand"):
            number = unit.identifiers.identifier(name)
            frames.append((f"{unit.node_name}_{name}", number, bytes.fromhex("1016182000010203")))
            frames.append((f"{unit.node_name}_{name}", number, bytes.fromhex("210405060708090A")))
            frames.append((f"{unit.node_name}_{name}", number, bytes.fromhex("30000ACCCCCCCCCC")))
            frames.append((f"{unit.node_name}_{name}", number, bytes.fromhex("03010203CCCCCCCC")))
    return [(name, CanFrame(number, data)) for name, number, data in frames]


def test_a_candump_log_of_several_units_decodes_wholly() -> None:
    log = bus_log()
    text = "".join(candump_line(frame, 1000 + n, "vcan0") + "\n" for n, (_, frame) in enumerate(log))
    parser = cantools.logreader.Parser(io.StringIO(text))
    lines = list(parser.iterlines(keep_unknowns=True))
    assert len(lines) == len(log)
    for (name, frame), (line, read) in zip(log, lines, strict=True):
        assert read is not None, line
        assert (read.frame_id, read.data) == (frame.identifier, frame.data)
        message = DATABASE.get_message_by_frame_id(read.frame_id)
        assert message.name == name
        assert message.decode(read.data)


def test_units_of_other_identifiers_on_one_bus() -> None:
    moved = CanIdentifiers(12, False, default_bases(False) | {"sync": 0x000})
    database = load(can_database([UNITS[0], DbcUnit("delta", moved), DbcUnit("beta", LONG.identifiers)]))
    names = {message.name: message.frame_id for message in database.messages}
    syncs = {"sync_80": 0x80, "sync_0": 0, "sync_2000000": 0x80 << 18}
    assert {name: number for name, number in names.items() if name.startswith("sync_")} == syncs
    assert database.get_message_by_name("time_at_sync_100").receivers == {"alpha_10", "delta_12"}
    assert database.get_message_by_name("time_at_sync_4000000").receivers == {"beta_10"}


def test_long_names_are_short_in_the_file_and_whole_in_the_tool() -> None:
    name = "a_star_tracker_with_a_very_long_name"
    units = [DbcUnit(name, CanIdentifiers(node)) for node in (100, 101)]
    text = can_database(units)
    database = load(text)
    assert {f"{name}_100_mid_exposure_time", f"{name}_101_rates"} <= {m.name for m in database.messages}
    assert [node.name for node in database.nodes] == ["OBC", f"{name}_100", f"{name}_101"]
    assert database.get_message_by_name(f"{name}_101_rates").senders == [f"{name}_101"]
    written = re.findall(r"^BO_ \d+ (\w+): \d+ (\w+)$", text, re.MULTILINE)
    assert len(written) == len(database.messages)
    assert len({message for message, _ in written}) == len(written)
    assert all(len(word) <= 32 for pair in written for word in pair)


def test_frames_that_could_not_be_told_apart_are_refused() -> None:
    with pytest.raises(LocalProtocolError, match="DBC: units = 'alpha_10'; allowed: each unit and node once"):
        can_database([UNITS[0], UNITS[0]])
    with pytest.raises(LocalProtocolError, match=r"beta_10_heartbeat = '0x70A'.* not alpha_10_heartbeat's"):
        can_database([UNITS[0], DbcUnit("beta", CanIdentifiers(10))])
    # One unit's SYNC is another's time.
    swapped = default_bases(False) | {"sync": 0x100, "time_at_sync": 0x080}
    with pytest.raises(LocalProtocolError, match=r"DBC: sync_100 = '0x100'.* not time_at_sync_100's"):
        can_database([UNITS[0], DbcUnit("beta", CanIdentifiers(11, False, swapped))])
