"""Packets, their error control and SLIP in C: golden bytes, the emulator's codec, and two other ones."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spacepackets.ecss.tm import MiscParams, PusTm

from hil_tests.vectors import reference_decoder
from st_emulator.firmware_model.link_work import packet_work, round_work, telecommand_work
from st_emulator.firmware_model.work import Work
from st_emulator.protocol import (
    CucTime,
    FrameReceived,
    Malformed,
    SlipDecoder,
    parse_telecommand,
    slip_encode,
)
from st_emulator.protocol.pus.enumerations import MalformedReason, Mode, Reason, TimeStatus
from st_emulator.protocol.pus.packets import error_controlled_bytes
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps.link_rounds import (
    APID,
    VERIFICATIONS,
    LinkRound,
    Packet,
    StoredImage,
    own_records,
    record_of,
)
from tools.calibration.steps.step import MismatchError
from tools.calibration.steps.telemetry import STEPS
from tools.calibration.struct_layout import layout_of, read_structs, reserve_structs

(TELEMETRY,) = STEPS
SHARED_MACHINE = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
FILE = Path(__file__).parents[1] / "vectors" / "golden_packets.json"
GOLDEN = {vector["name"]: vector for vector in json.loads(FILE.read_text())["vectors"]}
HEADER_BYTES, PART_HEADER_BYTES = 20, 4

U16, U32 = st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1)
FLAG = st.integers(0, 1)
SINGLE = st.floats(width=32, allow_nan=False, allow_infinity=False)
TIMES = st.builds(CucTime, U32, st.integers(0, 2**24 - 1))
STATUSES = st.sampled_from([int(status) for status in TimeStatus])
HEADERS = st.fixed_dictionaries(
    {
        "apid": st.integers(0, 2046),
        "sequence_count": st.integers(0, 2**14 - 1),
        "message_count": U16,
        "destination_id": U16,
        "time": TIMES,
        "time_status": STATUSES,
    }
)
# Doubles, not only those that a single holds: the rounding is the kernel's.
DOUBLES = st.floats(-3e38, 3e38)
REPORTS = st.fixed_dictionaries(
    {
        "frame_index": U32,
        "mid_exposure_time": TIMES,
        "time_status": STATUSES,
        "mode": st.sampled_from([int(mode) for mode in Mode]),
        "valid": FLAG,
        "reasons": st.integers(0, sum(Reason)),
        **{f"q_{axis}": st.floats(allow_nan=False, allow_infinity=False) for axis in "xyzw"},
        **{f"covariance_{name}": DOUBLES for name in ("xx", "xy", "xz", "yy", "yz", "zz")},
        "rate_valid": FLAG,
        **{f"rate_{axis}": DOUBLES for axis in "xyz"},
        "rate_covariance_valid": FLAG,
        **{f"rate_covariance_{name}": DOUBLES for name in ("xx", "xy", "xz", "yy", "yz", "zz")},
        **dict.fromkeys(("spots_detected", "stars_identified", "windows", "window_half_width_px"), U16),
        **dict.fromkeys(("residual_rms_arcsec", "background_dn", "noise_dn"), DOUBLES),
        **dict.fromkeys(("exposure_us", "cycles", "latency_us"), U32),
        "late": FLAG,
        "frames_dropped_before": U16,
        "false_match_probability": st.floats(0.0, 1.0),
    }
)
TINY = {
    "covariance_xx": 1e-45,
    "covariance_xy": -1.4e-45,
    "covariance_xz": 5e-324,
    "covariance_yy": 1.1754943e-38,
}


def line_of(machine: ArmMachine, packet: Packet) -> bytes:
    """The packet's SLIP frame from the kernels, which the binding has compared with the emulator's codec."""
    record = record_of(LinkRound(packets=(packet,)))
    TELEMETRY.run(machine, record)
    return bytes(record.result.line)


def native(value: Any) -> Any:
    """Fields as the golden file writes them to those of the codec."""
    if isinstance(value, dict) and "$time" in value:
        return CucTime(*value["$time"])
    if isinstance(value, dict) and "$hex" in value:
        return bytes.fromhex(value["$hex"])
    return {name: native(item) for name, item in value.items()} if isinstance(value, dict) else value


@pytest.mark.parametrize("name", ["attitude", "accepted", "image_start"])
def test_golden_packets(machine: ArmMachine, name: str) -> None:
    vector = GOLDEN[name]
    header = vector["header"] | {"time": CucTime(**vector["header"]["time"])}
    fields = native(vector["fields"])
    image = None
    if name == "image_start":
        data = fields["data"]
        image = StoredImage(data[:-2], np.frombuffer(data[-2:], ">u2").astype(np.uint16))
    expected = b"".join(bytes.fromhex(part["hex"]) for part in vector["bytes"])
    line = line_of(machine, Packet(vector["message"], fields, header, image))
    assert line == reference_decoder.slip_frame(expected)


@SHARED_MACHINE
@given(HEADERS, REPORTS)
def test_attitude_reports_with_any_fields(
    machine: ArmMachine, header: dict[str, Any], fields: dict[str, Any]
) -> None:
    line = line_of(machine, Packet("attitude_report", fields, header))
    (raw,) = reference_decoder.slip_frames(line)
    decoded = reference_decoder.decode_telemetry(raw)
    for name, value in fields.items():
        if isinstance(value, CucTime):
            value = (value.coarse, value.fine)
        elif isinstance(value, float) and not name.startswith("q_"):
            (value,) = struct.unpack(">f", struct.pack(">f", value))
        assert decoded["fields"][name] == value, name
    assert _as_spacepackets_has_it(raw, header) == raw


def _as_spacepackets_has_it(raw: bytes, header: dict[str, Any]) -> bytes:
    """The packet built by the package ``spacepackets`` from the header's values and the packet's data."""
    packet = PusTm(
        service=raw[7],
        message_subtype=raw[8],
        timestamp=header["time"].as_bytes(),
        source_data=raw[HEADER_BYTES:-2],
        apid=header["apid"],
        seq_count=header["sequence_count"],
        message_counter=header["message_count"],
        destination_id=header["destination_id"],
        misc_params=MiscParams(spacecraft_time_ref=header["time_status"]),
    )
    return bytes(packet.pack())


def test_singles_too_small_for_their_exponent(machine: ArmMachine) -> None:
    fields = native(GOLDEN["attitude"]["fields"]) | TINY
    header = GOLDEN["attitude"]["header"] | {"time": CucTime(0, 0)}
    line_of(machine, Packet("attitude_report", fields, header))


@SHARED_MACHINE
@given(HEADERS, st.sampled_from(VERIFICATIONS), st.binary(min_size=4, max_size=4))
def test_verification_reports(machine: ArmMachine, header: dict[str, Any], name: str, request: bytes) -> None:
    fields = {"request_id": reference_request(request)}
    (raw,) = reference_decoder.slip_frames(line_of(machine, Packet(name, fields, header)))
    assert raw[HEADER_BYTES:-2] == request
    assert _as_spacepackets_has_it(raw, header) == raw


def reference_request(request: bytes) -> dict[str, int]:
    word, sequence = struct.unpack(">HH", request)
    return {
        "version": word >> 13,
        "packet_type": word >> 12 & 1,
        "secondary_header": word >> 11 & 1,
        "apid": word & 0x7FF,
        "sequence_flags": sequence >> 14,
        "sequence_count": sequence & 0x3FFF,
    }


@SHARED_MACHINE
@given(HEADERS, st.data())
def test_parts_of_an_image_from_anywhere(
    machine: ArmMachine, header: dict[str, Any], data: st.DataObject
) -> None:
    prologue = data.draw(st.binary(max_size=30))
    pixels = np.frombuffer(data.draw(st.binary(min_size=2, max_size=400)).ljust(400, b"\xc0"), np.uint16)
    whole = prologue + b"".join(int(pixel).to_bytes(2, "big") for pixel in pixels)
    offset = data.draw(st.integers(0, len(whole) - 1))
    part = whole[offset : offset + data.draw(st.integers(1, 300))]
    fields = {"transaction_id": 7, "part_number": 3, "data": part}
    packet = Packet("image_part", fields, header, StoredImage(prologue, pixels), offset)
    (raw,) = reference_decoder.slip_frames(line_of(machine, packet))
    assert raw[HEADER_BYTES + PART_HEADER_BYTES : -2] == part
    assert _as_spacepackets_has_it(raw, header) == raw


def crc(machine: ArmMachine, symbol: str, data: bytes) -> int:
    place = machine.place(np.frombuffer(data, np.uint8))
    result = machine.call(symbol, place, len(data)).result
    machine.release()
    return result


@SHARED_MACHINE
@given(st.binary(max_size=300))
def test_error_control_by_table_and_bit_by_bit(machine: ArmMachine, data: bytes) -> None:
    expected = reference_decoder.crc16(data)
    assert crc(machine, "st_crc16", data) == crc(machine, "st_crc16_bitwise", data) == expected
    packet = data + expected.to_bytes(2, "big")
    assert crc(machine, "st_crc16", packet) == 0
    place = machine.place(np.frombuffer(data[: len(data) // 2 * 2], ">u2").astype(np.uint16))
    pixels = machine.call("st_crc16_pixels", place, len(data) // 2).result
    machine.release()
    assert pixels == reference_decoder.crc16(data[: len(data) // 2 * 2])


def test_error_control_of_the_standard(machine: ArmMachine) -> None:
    """The check values of ECSS-E-ST-70-41C, annex B.1.5."""
    for data, expected in (
        ("0000", 0x1D0F),
        ("000000", 0xCC9C),
        ("ABCDEF01", 0x04A2),
        ("1456F89A0001", 0x7FD5),
    ):
        assert crc(machine, "st_crc16", bytes.fromhex(data)) == expected


@pytest.mark.parametrize(("symbol", "trial"), [("st_crc16", 12.0), ("st_crc16_bitwise", 71.0)])
def test_error_control_costs_what_a_trial_found(machine: ArmMachine, symbol: str, trial: float) -> None:
    """Core cycles a byte: 12 by table and 71 bit by bit in an earlier trial."""
    place = machine.place(np.random.default_rng(60).integers(0, 256, 2000).astype(np.uint8))
    cycles = [machine.call(symbol, place, count).cost.core_cycles for count in (1000, 2000)]
    assert (cycles[1] - cycles[0]) / 1000 == pytest.approx(trial, rel=0.15)


def packets_in(line: bytes) -> list[bytes]:
    return [e.data for e in SlipDecoder(1024).receive(line, 0) if isinstance(e, FrameReceived)]


DAMAGE = st.sampled_from(
    ["none", "bit", "length", "cut", "version", "type", "flag", "segment", "pus", "apid"]
)


@st.composite
def lines(draw: st.DrawFn) -> bytes:
    """Telecommands, whole and damaged in every way that the headers' checks know, with noise between."""
    line = b""
    for _ in range(draw(st.integers(1, 5))):
        data = draw(st.binary(max_size=60))
        apid = APID if draw(st.booleans()) else draw(st.integers(0, 2046))
        raw = bytearray(
            reference_decoder.telecommand_packet(
                draw(st.integers(0, 255)), draw(st.integers(0, 255)), data, apid, draw(st.integers(0, 16383))
            )
        )
        damage = draw(DAMAGE)
        place, value = {
            "version": (0, 0x20), "type": (0, 0x10), "flag": (0, 0x08), "segment": (2, 0x40), "pus": (6, 0x10)
        }.get(damage, (0, 0))  # fmt: skip
        raw[place] ^= value
        if damage == "length":
            raw[5] ^= 1
        raw[-2:] = reference_decoder.crc16(raw[:-2]).to_bytes(2, "big")
        if damage == "bit":
            raw[draw(st.integers(0, len(raw) - 1))] ^= 1 << draw(st.integers(0, 7))
        if damage == "cut":
            raw = raw[: draw(st.integers(0, len(raw) - 1))]
        line += reference_decoder.slip_frame(bytes(raw)) + draw(
            st.one_of(st.just(b""), st.binary(max_size=20), st.just(b"\xdb"), st.just(b"\xdb\x00\xc0\xc0"))
        )
    return line


@SHARED_MACHINE
@given(lines())
def test_telecommands_whole_and_damaged(machine: ArmMachine, line: bytes) -> None:
    record = record_of(LinkRound(line=line))
    TELEMETRY.run(machine, record)
    told = [found.reason for found in record.result.telecommands]
    reasons = []
    for raw in packets_in(line):  # the headers' checks against the whole parser's
        packet = parse_telecommand(raw, apids={APID})
        reason = packet.reason if isinstance(packet, Malformed) else 0
        reasons.append(0 if reason > MalformedReason.BAD_PUS_VERSION else int(reason))
    assert [reason for reason in told if reason < MalformedReason.FRAME_OVERSIZED] == reasons


def test_every_reason_is_found(machine: ArmMachine) -> None:
    good = bytearray(reference_decoder.telecommand_packet(17, 1, b"", APID, 5, 0x1234, 9))
    frames = {
        0: bytes(good),
        MalformedReason.TOO_SHORT: bytes(good[:9]),
        MalformedReason.BAD_CRC: bytes(12) + b"\x01",
    }
    frames[MalformedReason.BAD_CRC] = bytes(good[:-1]) + bytes([good[-1] ^ 1])
    for reason, place, value in (
        (MalformedReason.LENGTH_MISMATCH, 5, 0x01),
        (MalformedReason.BAD_VERSION, 0, 0x80),
        (MalformedReason.NOT_TELECOMMAND, 0, 0x10),
        (MalformedReason.UNKNOWN_APID, 1, 0x01),
        (MalformedReason.NO_SECONDARY_HEADER, 0, 0x08),
        (MalformedReason.SEGMENTED, 2, 0x40),
        (MalformedReason.BAD_PUS_VERSION, 6, 0x10),
    ):
        raw = good.copy()
        raw[place] ^= value
        raw[-2:] = reference_decoder.crc16(raw[:-2]).to_bytes(2, "big")
        frames[reason] = bytes(raw)
    line = b"".join(map(slip_encode, frames.values()))
    line += b"\xc0" + b"\x01" * 1025 + b"\xc0" + b"\x02\xdb\x03\xc0"
    record = record_of(LinkRound(line=line))
    TELEMETRY.run(machine, record)
    found = record.result.telecommands
    assert [one.reason for one in found] == [*frames, 16, 17]
    first = found[0]
    assert (first.length, first.sequence_count, first.ack) == (13, 5, 9)
    assert (first.service, first.subservice, first.source_id) == (17, 1, 0x1234)
    assert [one.length for one in found[-2:]] == [1025, 3]
    altered = (replace(first, source_id=0x1235), *found[1:])
    with pytest.raises(MismatchError, match="telecommands"):
        TELEMETRY.run(machine, replace(record, result=replace(record.result, telecommands=altered)))


@SHARED_MACHINE
@given(lines(), st.lists(st.integers(1, 60), max_size=8))
def test_the_line_may_be_cut_anywhere(machine: ArmMachine, line: bytes, sizes: Sequence[int]) -> None:
    decoder = reserve_structs(machine, "st_slip_decoder")
    found = reserve_structs(machine, "st_telecommand", 40)
    nbytes = layout_of(machine, "st_telecommand").nbytes
    whole = machine.place(np.frombuffer(line, np.uint8))
    number = start = 0
    for size in (*sizes, len(line)):
        part = min(size, len(line) - start)
        number += machine.call(
            "st_telecommands", decoder, whole + start, part, APID, found + nbytes * number, 40 - number
        ).result
        start += part
    received = read_structs(machine, "st_telecommand", found, number)
    machine.release()
    expected = record_of(LinkRound(line=line)).result.telecommands
    assert received["reason"].tolist() == [one.reason for one in expected]
    assert received["length"].tolist() == [one.length for one in expected]


def test_a_wrong_byte_would_be_seen(machine: ArmMachine) -> None:
    record = own_records(3, 1)[0]
    TELEMETRY.run(machine, record)
    line = bytearray(record.result.line)
    line[40] ^= 1
    with pytest.raises(MismatchError, match="telemetry: line"):
        TELEMETRY.run(machine, replace(record, result=replace(record.result, line=bytes(line))))


def test_own_records_are_the_same_for_a_seed_and_varied() -> None:
    lengths = [len(record.result.line) for record in own_records(4, 30)]
    assert lengths == [len(record.result.line) for record in own_records(4, 30)]
    assert lengths != [len(record.result.line) for record in own_records(5, 30)]
    counted = sum((record.work for record in own_records(4, 30)), Work())
    for name in ("telemetry_bytes", "image_bytes", "crc_bytes", "image_crc_pixels", "telecommand_bytes"):
        assert counted[name] > 100, name


def test_work_of_the_link() -> None:
    assert packet_work(100) == Work({"telemetry_bytes": 100, "crc_bytes": 100})
    assert packet_work(100, 70) == Work({"telemetry_bytes": 30, "image_bytes": 70, "crc_bytes": 100})
    ping = reference_decoder.telecommand_packet(17, 1, b"", APID, 5)
    assert telecommand_work(error_controlled_bytes(ping)) == Work({"telecommands": 1, "crc_bytes": 13})
    assert telecommand_work(error_controlled_bytes(ping[:-1])) == Work(
        {"telecommands": 1}
    )  # refused before the sum
    assert telecommand_work(error_controlled_bytes(b"")) == Work({"telecommands": 1})
    assert round_work(Work(), Work()) == Work()
    sent = packet_work(20)
    assert round_work(sent, Work()) == sent + Work({"sending_rounds": 1})
    assert round_work(Work(), telecommand_work(0))["receiving_rounds"] == 1


def test_counts_predict_the_core_cycles_of_the_link(machine: ArmMachine) -> None:
    """Coefficients from some rounds foretell others to a tenth."""
    runs = [
        run
        for seed in range(70, 78)
        for record in own_records(seed, 8)
        for run in TELEMETRY.run(machine, record)
    ]
    names = sorted({name for run in runs for name in run.work.counts})
    for kib in (32, 4):
        cycles = np.array([run.cost.core_cycles + run.cost.memory_cycles(48.0, kib) for run in runs])
        relative = np.array([[run.work[name] for name in names] for run in runs]) / cycles[:, None]
        coefficients = np.linalg.lstsq(relative[:40], np.ones(40), rcond=None)[0]
        assert np.abs(relative[40:] @ coefficients - 1.0).max() < 0.10
