"""The OBC's calls on a CAN bus, against a unit made with struct, in steps of a millisecond."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hil_tests.obc.can_unit import (
    ATTITUDE_1,
    ATTITUDE_2,
    HEARTBEAT,
    MID_EXPOSURE,
    RATES,
    STATUS,
    SYNC_TIME,
    TELEMETRY,
    Bus,
    CanUnit,
    bits,
    clock,
    half,
    heartbeat,
    status,
)
from st_emulator.links import LinkError
from st_emulator.obc import (
    CanTransport,
    CucTime,
    Mode,
    NoBusError,
    Obc,
    SteppedReader,
    TelecommandNotDelivered,
    TelecommandTimeout,
    TelemetryTimeout,
    UnitNotChosenError,
    VerificationError,
)
from st_emulator.protocol.can.cyclic import CanIdentifiers
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.protocol.pus.enumerations import Reason

MS = 1_000_000


class Bench:
    """A bus, its units, and OBCs that make the time."""

    def __init__(self, wire: Any) -> None:
        self.wire = wire
        self.bus = Bus()
        self.units: list[CanUnit] = []

    def unit(self, node: int = 10, **options: Any) -> CanUnit:
        unit = CanUnit(self.wire, self.bus.attach(), node, **options)
        unit.fake.answer((17, 1), lambda request: unit.fake.send(17, 2))
        self.units.append(unit)
        return unit

    def obc(self, node: int | None = 10, **options: Any) -> Obc:
        transport = CanTransport(None if node is None else CanIdentifiers(node))
        options.setdefault("apid", self.wire.APID)
        return Obc(self.bus.attach(), reader=SteppedReader(self.step), transport=transport, **options)

    def step(self, now_ns: int) -> None:
        self.bus.step()
        for unit in self.units:
            unit.step(now_ns)
        self.bus.step()


@pytest.fixture
def bench(wire: Any) -> Bench:
    return Bench(wire)


@pytest.fixture
def unit(bench: Bench) -> CanUnit:
    return bench.unit()


@pytest.fixture
def obc(bench: Bench, unit: CanUnit) -> Iterator[Obc]:
    with bench.obc(source_id=42) as opened:
        yield opened


def counted(obc: Obc) -> dict[str, int]:
    left_out = ("received_bytes", "sent_bytes", "frames_received", "frames_sent")
    return {name: n for name, n in obc.counters.as_dict().items() if n and name not in left_out}


# Telecommands and telemetry


def test_ping(obc: Obc, unit: CanUnit) -> None:
    assert 0 < obc.ping() < 0.02
    assert [request.source_id for request in unit.fake.requests] == [42]
    first, second = (data for _, identifier, data in unit.heard if data[0] >> 4 < 3)
    packet = unit.fake.requests[0].packet
    assert (first, second) == (b"\x10\x0d" + packet[:6], b"\x21" + packet[6:])
    assert counted(obc) == {
        "packets": 3,
        "telecommands_sent": 1,
        "telecommands_verified": 1,
        "transfers_received": 3,
        "transfers_sent": 1,
        "flow_controls_sent": 3,
    }


@pytest.mark.parametrize(("stmin", "apart_ns"), [(0x05, 5 * MS), (0xF3, 300_000)])
def test_a_long_telecommand_at_the_units_pace(bench: Bench, stmin: int, apart_ns: int) -> None:
    unit = bench.unit(flow_control=bytes((0x30, 3, stmin)))  # blocks of three
    unit.fake.answer((6, 2))
    with bench.obc() as obc:
        data = bytes(n % 251 for n in range(256))
        obc.memory_load("RAM", 0x100, data)
    assert unit.fake.requests[0].data == struct.pack(">BIH", 1, 0x100, 256) + data + struct.pack(
        ">H", bench.wire.crc16(data)
    )
    consecutive = [now_ns for now_ns, identifier, frame in unit.heard if frame[0] >> 4 == 2]
    assert len(consecutive) == -(-(len(unit.fake.requests[0].packet) - 6) // 7)
    apart = [b - a for a, b in pairwise(consecutive)]
    # A step of a millisecond is cut short where the next frame is due in between; none is behind the last.
    assert set(apart[::3]) == {apart_ns}
    assert min(apart) == apart_ns


def test_a_refusal_comes_back(obc: Obc, unit: CanUnit) -> None:
    unit.fake.handlers[(8, 1)] = lambda request: unit.fake.fail(request, 2, 7, 4)
    with pytest.raises(VerificationError, match="NOT_ALLOWED_IN_MODE"):
        obc.standby()


def test_several_telecommands_at_once(obc: Obc, unit: CanUnit) -> None:
    verifications = [obc.begin("ping") for _ in range(5)]
    for verification in verifications:
        obc.finish(verification)
    assert [request.count for request in unit.fake.requests] == [0, 1, 2, 3, 4]


def test_a_unit_without_flow_control_is_named_as_such(bench: Bench) -> None:
    bench.unit(flow_control=None)
    with bench.obc() as obc:
        with pytest.raises(
            TelecommandNotDelivered, match=r"not delivered: N_Bs: no flow control came"
        ) as caught:
            obc.standby()
        assert isinstance(caught.value, TelecommandTimeout)
        assert obc.now_ns() == 1_000 * MS  # not the five seconds for which an answer is waited for
        with pytest.raises(TelecommandTimeout, match="no flow control"):
            obc.ping(0.2)
        assert counted(obc) == {
            "telecommands_sent": 2,
            "telecommands_not_delivered": 1,
            "telecommands_timed_out": 1,
            "transmissions_failed": 1,
            "timeout_bs": 1,
        }


def test_after_flow_control_that_never_came_the_next_command_is_answered(bench: Bench) -> None:
    unit = bench.unit(flow_control=None)
    with bench.obc() as obc:
        with pytest.raises(TelecommandNotDelivered):
            obc.standby()
        unit.flow_control = b"\x30\x00\x00"
        assert obc.ping() > 0


def test_a_bus_that_takes_nothing(bench: Bench) -> None:
    with bench.obc() as obc:
        obc.link.write = lambda data: 0  # type: ignore[method-assign]
        with pytest.raises(TelecommandNotDelivered, match="N_As"):
            obc.standby()
        with pytest.raises(LinkError, match="did not take a frame within 1 s"):
            obc.sync()
        assert obc.counters.as_dict()["frames_lost"] == 1


def test_lost_telemetry_frames_cost_their_packet_alone(obc: Obc, unit: CanUnit, bench: Bench) -> None:
    lost = iter([False] * 3 + [True] + [False] * 1000)
    unit.lose = lambda identifier, data: identifier == TELEMETRY + 10 and data[0] >> 4 == 2 and next(lost)
    for frame in range(4):
        unit.fake.attitude(frame=frame)
        obc.wait(0.1)
    frames = [entry.telemetry.fields["frame_index"] for entry in obc.telemetry_since()]
    assert frames == [1, 2, 3]
    assert obc.counters.as_dict()["wrong_sequence"] == 1
    assert obc.ping() > 0


def test_raw_packets(obc: Obc, unit: CanUnit) -> None:
    seen: list[bytes] = []
    unit.fake._receive = seen.append  # type: ignore[method-assign]
    assert obc.send_raw(b"\x01\x02\x03", framed=True) == 3
    assert obc.send_raw(bytes(20), framed=True) == 20
    obc.wait(0.05)
    assert seen == [b"\x01\x02\x03", bytes(20)]
    record = struct.pack(">IBBH", 0x7FF, 2, 0, 0) + b"\xab\xcd"
    assert obc.send_raw(record) == len(record)
    obc.wait(0.01)
    assert unit.heard[-1][1:] == (0x7FF, b"\xab\xcd")


@pytest.mark.parametrize("part_bytes", [100, 4069])
def test_an_image_in_parts_of_any_length(obc: Obc, unit: CanUnit, bench: Bench, part_bytes: int) -> None:
    pixels = np.arange(100 * 80, dtype=np.uint16).reshape(80, 100)
    body = pixels.astype(">u2").tobytes()
    header = struct.pack(">IHHBB", 7, 100, 80, 16, 0) + bench.wire.CUC
    data = header + struct.pack(">IH", 1, bench.wire.crc16(body)) + body
    parts = [data[start : start + part_bytes] for start in range(0, len(data), part_bytes)]

    def handle(request: Any) -> None:
        unit.fake.report(request, 1)
        for number, part in enumerate(parts, start=1):
            subservice = 1 if number == 1 else 3 if number == len(parts) else 2
            unit.fake.send(13, subservice, request.data[1:3] + struct.pack(">H", number) + part)
        unit.fake.report(request, 7)

    unit.fake.handlers[(8, 1)] = handle
    image = obc.fetch_image()
    assert np.array_equal(image.pixels, pixels)
    longest = max(len(entry.telemetry.raw) for entry in obc.telemetry_since())
    assert longest == part_bytes + 26  # headers of 6 and 14, transaction, part number, error control


# Which unit


def test_two_units_on_one_bus_are_not_mixed(bench: Bench) -> None:
    units = [bench.unit(node) for node in (10, 11)]
    with bench.obc(10) as first, bench.obc(11) as second:
        for _ in range(3):
            for unit in units:
                unit.fake.attitude(frame=unit.node)
                unit.put(ATTITUDE_1 + unit.node, half(unit.node, 0.1, 0.2))
            verifications = [first.begin("ping"), second.begin("ping")]
            for _ in range(50):  # both OBCs' time goes on
                first.wait(0.001)
                second.wait(0.001)
            assert all(verification.finished for verification in verifications)
        for obc, node in ((first, 10), (second, 11)):
            reports = [e for e in obc.telemetry_since() if e.telemetry.name == "attitude_report"]
            assert [e.telemetry.fields["frame_index"] for e in reports] == [node] * 3
            assert [frame.values["counter"] for frame in obc.cyclic_since()] == [node] * 3
            counters = obc.counters.as_dict()
            assert counters["frames_of_others"] > 0
            assert (counters["crc_errors"], counters["malformed"], counters["sequence_gaps"]) == (0, 0, 0)
            assert (counters["receptions_failed"], counters["transfer_frames_ignored"]) == (0, 0)
    assert [len(unit.fake.requests) for unit in units] == [3, 3]


def test_node_and_apid_are_learned(bench: Bench) -> None:
    unit = bench.unit(77, heartbeat_ms=1000)
    with bench.obc(None, apid=None) as obc:
        assert obc.transport.description == {"node": None}
        unit.fake.attitude(after_ms=1200)
        obc.ping()
        assert obc.transport.description == {"node": 77}
        assert obc.destination_apid == bench.wire.APID
        assert unit.fake.requests[0].apid == bench.wire.APID


def test_several_units_and_no_node_is_an_error_before_anything_is_sent(bench: Bench) -> None:
    units = [bench.unit(node, heartbeat_ms=1000) for node in (10, 12)]
    with bench.obc(None) as obc:
        with pytest.raises(UnitNotChosenError, match="nodes 10, 12"):
            obc.ping()
        with pytest.raises(UnitNotChosenError, match="nodes 10, 12"):
            obc.wait(1)
        with pytest.raises(UnitNotChosenError, match="nodes 10, 12"):
            obc.wait_for_cyclic("heartbeat")
        units[0].fake.attitude()
        with pytest.raises(UnitNotChosenError, match="nodes 10, 12"):
            obc.wait_for("attitude_report")
    assert not any(unit.fake.requests for unit in units)


def test_no_heartbeat_and_no_node_is_an_error(bench: Bench) -> None:
    bench.unit()
    with bench.obc(None) as obc, pytest.raises(UnitNotChosenError, match="no unit's heartbeat came"):
        obc.ping()


# Cyclic frames


def test_the_latest_cyclic_frame(obc: Obc, unit: CanUnit) -> None:
    assert obc.cyclic("heartbeat") is None
    obc.wait(0.1)
    for counter in (1, 2):
        unit.put(HEARTBEAT + 10, heartbeat(counter, mode=3))
    obc.wait(0.05)
    frame = obc.cyclic("heartbeat")
    assert frame is not None
    assert (frame.values["counter"], frame.time_ns) == (2, 101 * MS)
    assert obc.unit.mode is Mode.LOST_IN_SPACE
    with pytest.raises(ValueError, match="'sync' is no cyclic frame; there are heartbeat"):
        obc.cyclic("sync")


def test_waiting_for_a_cyclic_frame(obc: Obc, unit: CanUnit) -> None:
    mark = obc.mark()
    unit.put(STATUS + 10, status(1, valid=0, reasons=1))
    unit.put(STATUS + 10, status(2))
    unit.fake.attitude()
    obc.wait(0.05)
    found = obc.wait_for_cyclic("status", lambda values: values["valid"] == 1, since=mark)
    assert found.values["counter"] == 2
    assert [frame.values["counter"] for frame in obc.cyclic_since(mark)] == [1, 2]
    assert [entry.number for entry in obc.telemetry_since(mark)] == [2]
    assert obc.cyclic_since(found.number + 1) == []
    with pytest.raises(TelemetryTimeout, match=r"cyclic frame status: did not come within 0\.1 s; none came"):
        obc.wait_for_cyclic("status", timeout_s=0.1)
    with pytest.raises(TelemetryTimeout, match="2 came, none as wanted"):
        obc.wait_for_cyclic("status", lambda values: False, 0.1, since=mark)


def test_an_attitude_of_two_halves(obc: Obc, unit: CanUnit) -> None:
    unit.put(ATTITUDE_1 + 10, half(5, 0.5, 0.5))
    unit.put(ATTITUDE_2 + 10, half(5, -0.5, 0.5))
    unit.put(RATES + 10, bits((5, 8), (1, 1), (0, 1), (0, 18), (1 << 10, 18), (-1024, 18)))
    unit.put(STATUS + 10, status(5, valid=0, reasons=6))
    unit.put(MID_EXPOSURE + 10, clock(5, 2_000_000_000, 1 << 23))
    unit.put(ATTITUDE_1 + 10, half(6, 1.0, 0.0))  # its other half is lost
    unit.put(ATTITUDE_2 + 10, half(7, 0.25, 0.75))
    obc.wait(0.01)
    (attitude,) = obc.cyclic_attitudes()
    assert attitude.q_icrs_to_sensor.tolist() == [0.5, 0.5, -0.5, 0.5]
    assert (attitude.counter, attitude.valid, attitude.reasons) == (
        5,
        False,
        Reason.BLINDED | Reason.NO_MATCH,
    )
    assert attitude.time == CucTime(2_000_000_000, 1 << 23)
    assert attitude.rate_rad_s is not None
    assert attitude.rate_rad_s.tolist() == [0.0, 2.0**-9, -(2.0**-9)]


def test_a_new_start_joins_nothing_to_what_came_before(obc: Obc, unit: CanUnit) -> None:
    unit.put(HEARTBEAT + 10, heartbeat(1, boot_count=1))
    unit.put(ATTITUDE_1 + 10, half(5, 0.5, 0.5))
    unit.put(HEARTBEAT + 10, heartbeat(0, boot_count=2))
    unit.put(ATTITUDE_2 + 10, half(5, 0.5, 0.5))
    unit.put(ATTITUDE_1 + 10, half(6, 0.5, 0.5))
    obc.wait(0.01)
    unit.fake.event(1, struct.pack(">HB", 9, 1))  # BOOT_COMPLETED
    obc.wait(0.05)
    unit.put(ATTITUDE_2 + 10, half(6, 0.5, 0.5))
    obc.wait(0.01)
    assert obc.cyclic_attitudes() == []


# SYNC


def answering(unit: CanUnit, bench: Bench) -> None:
    """The unit latches its time at SYNC and takes over the time that follows."""

    def on_frame(identifier: int, data: bytes) -> None:
        if identifier == 0x080:
            unit.put(SYNC_TIME + 10, clock(data[0] if data else 0, 1000, 1 << 22))
        elif identifier == 0x100:
            new = data[1:5] + data[5:8]
            unit.fake.event(12, bench.wire.CUC + new, after_ms=250)

    unit.on_frame = on_frame


def test_sync_latches_the_units_time(obc: Obc, unit: CanUnit, bench: Bench) -> None:
    answering(unit, bench)
    obc.wait(0.5)
    sent = obc.sync()
    assert obc.time_at_sync(sent) == CucTime(1000, 1 << 22)
    assert [(identifier, data) for _, identifier, data in unit.heard] == [(0x080, b"\x00")]
    # Its 1 byte has 55 bits and up to 9 stuff bits on a bus of 1 Mbit/s.
    assert 500 * MS + 55_000 <= sent.time_ns <= 500 * MS + 64_000
    assert sent.utc.replace(microsecond=0) == datetime(2026, 1, 1, tzinfo=UTC)
    assert 500_055 <= sent.utc.microsecond <= 500_064
    assert obc.sync(200).counter == 200
    assert obc.sync().counter == 1
    with pytest.raises(LocalProtocolError):
        obc.sync(256)


def test_time_set_by_sync(obc: Obc, unit: CanUnit, bench: Bench) -> None:
    answering(unit, bench)
    event = obc.set_time_by_sync(CucTime(2_100_000_000, 0x123456))
    assert (event.name, event.data["new"]) == ("TIME_SET", CucTime(2_100_000_000, 0x123456))
    assert [data for _, identifier, data in unit.heard if identifier == 0x100] == [
        b"\x00" + struct.pack(">I", 2_100_000_000) + b"\x12\x34\x56"
    ]
    obc.wait(0.3)
    obc.set_time_by_sync()
    at_sync = [data for _, identifier, data in unit.heard if identifier == 0x100][1]
    # The stepped reader's epoch is 2026-01-01; 24,837 days after 1958-01-01 and 37 leap seconds.
    counter, seconds, fraction = at_sync[0], struct.unpack(">I", at_sync[1:5])[0], at_sync[5:8]
    assert (counter, seconds) == (1, 24_837 * 86_400 + 37)
    assert int.from_bytes(fraction, "big") / (1 << 24) == pytest.approx(obc.now_ns() / 1e9 - 0.251, abs=0.01)


def test_a_unit_that_does_not_take_the_time(obc: Obc, unit: CanUnit) -> None:
    with pytest.raises(
        TelemetryTimeout, match=r"event TIME_SET: .*; the unit did not answer the SYNC either"
    ):
        obc.set_time_by_sync(timeout_s=0.5)
    unit.on_frame = lambda identifier, data: (
        unit.put(SYNC_TIME + 10, clock(data[0], 1, 0)) if identifier == 0x080 else None
    )
    with pytest.raises(TelemetryTimeout, match="; the unit answered the SYNC"):
        obc.set_time_by_sync(timeout_s=0.5)


def test_any_frame(obc: Obc, unit: CanUnit) -> None:
    obc.send_frame(CanFrame(0x1ABCDE, b"\x01", extended=True))
    obc.wait(0.01)
    assert unit.heard[-1][1:] == (0x8000_0000 | 0x1ABCDE, b"\x01")
    with pytest.raises(LocalProtocolError, match="without ,fd"):
        obc.send_frame(CanFrame(0x1, bytes(12), fd=True))


def test_the_time_of_the_transfer_is_added_to_the_computers(obc: Obc, unit: CanUnit) -> None:
    unit.fake.answer((9, 128))
    obc.set_time()
    coarse, fine = struct.unpack(">IB", unit.fake.requests[0].data[:5])[0], unit.fake.requests[0].data[4:7]
    assert coarse == 24_837 * 86_400 + 37
    assert int.from_bytes(fine, "big") / (1 << 24) == pytest.approx(4 * 120e-6, rel=0.15)


def test_a_serial_line_has_none_of_it(link_pair: Any) -> None:
    with Obc(link_pair[1], reader=SteppedReader(lambda now_ns: None)) as obc:
        for call in (
            lambda: obc.cyclic("heartbeat"),
            lambda: obc.cyclic_since(),
            lambda: obc.cyclic_attitudes(),
            lambda: obc.wait_for_cyclic("heartbeat"),
            lambda: obc.sync(),
            lambda: obc.set_time_by_sync(),
            lambda: obc.send_frame(CanFrame(1)),
        ):
            with pytest.raises(NoBusError, match=r"memory \(obc\) is no CAN bus"):
                call()
