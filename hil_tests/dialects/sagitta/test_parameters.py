"""Parameters: kept and read back, refused, and what the device understands of them."""

from __future__ import annotations

import math
import struct

import pytest

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import Bench, at_rest, unit
from hil_tests.dialects.sagitta.client import READ, REQUEST, SET
from st_emulator.device.store import VolatileStore
from st_emulator.firmware_model.causes import FaultCause

NOT_IMPLEMENTED, BAD_ARGUMENTS, NOT_NOW = 1, 2, 3


def changed(id_: int) -> bytes:
    """Arguments that are taken and are not the defaults."""
    if id_ == 6:
        return struct.pack("<4f", 0.5, 0.5, 0.5, 0.5)
    if id_ == 9:
        return client.camera(0.05)
    if id_ == 11:
        return struct.pack("<B12f", 1, 1, 2, 3, 4, 5, 6.5, 7, 8, 9, 10, 11, 12)
    if id_ == 15:
        return struct.pack("<BffB", 2, 1.5, 0.25, 4)
    if id_ == 16:
        return struct.pack("<BfBfB", 3, 0.5, 5, 0.5, 4)
    if id_ == 18:
        return client.subscription(27)
    return bytes(octet ^ 0x5A for octet in client.DEFAULTS[id_])


def test_defaults_are_read() -> None:
    bench = at_rest()
    for id_, default in client.DEFAULTS.items():
        frame = bench.one(READ, id_)
        assert frame.arguments == default  # no status: the arguments begin at byte 3
        assert len(frame.body) == client.PARAMETER_BYTES[id_] + 7


def test_each_is_set_and_read_back_as_it_came() -> None:
    bench = at_rest()
    for id_ in client.PARAMETER_BYTES:
        assert bench.status(SET, id_, changed(id_)) == 0
    for id_ in client.PARAMETER_BYTES:
        assert bench.one(READ, id_).arguments == changed(id_)


def test_the_drivers_start_up_leaves_a_unit_that_works() -> None:
    bench = at_rest()
    for id_, default in client.DEFAULTS.items():
        assert bench.status(SET, id_, default) == 0
    parameters = bench.device.parameters
    assert parameters["exposure_us"] == 75_000
    assert parameters["tracking_min_stars"] == 6
    own = bench.emulator.profile.detection.magnitude_limit
    assert parameters["magnitude_limit"] == struct.unpack("<f", struct.pack("<f", own))[0]


def test_arguments_of_a_wrong_length_are_refused() -> None:
    bench = at_rest()
    for id_, octets in client.PARAMETER_BYTES.items():
        for arguments in (b"", bytes(octets - 1), bytes(octets + 1)):
            assert bench.status(SET, id_, arguments) == BAD_ARGUMENTS
        assert bench.one(READ, id_).arguments == client.DEFAULTS[id_]


def test_a_parameter_that_is_none() -> None:
    bench = at_rest()
    for id_ in sorted({0, 1, 2, 4, 7, 17, 19, 24, 255} - set(client.PARAMETER_BYTES)):
        assert bench.status(SET, id_, b"\x00") == NOT_IMPLEMENTED
        assert bench.ask(READ, id_) == []  # a reply 81 has no status that could say so
    assert bench.ask(READ, 13, b"\x00") == []


def test_a_status_in_front_of_what_is_read() -> None:
    bench = at_rest(parameter_status=True)
    assert bench.one(READ, 13).arguments == b"\x00" + client.DEFAULTS[13]
    assert bench.one(READ, 200).arguments == bytes([NOT_IMPLEMENTED])
    assert bench.one(READ, 13, b"\x00").arguments == bytes([BAD_ARGUMENTS])


@pytest.mark.parametrize(
    ("id_", "arguments"),
    [
        (6, struct.pack("<4f", 1, 0.1, 0, 0)),
        (6, bytes(16)),
        (6, struct.pack("<4f", math.nan, 0, 0, 0)),
        (9, client.camera(0.0)),
        (9, client.camera(0.2501)),
        (9, client.camera(-1.0)),
        (9, client.camera(math.nan)),
        (9, client.camera(math.inf)),
        (9, client.camera(3e38)),
        (11, struct.pack("<B12f", 0, 0, 0, 0, 0, 0, -1, 0, 0, 0, 0, 0, 0)),
        (11, struct.pack("<B12f", 0, 0, 0, 0, 0, 0, math.nan, 0, 0, 0, 0, 0, 0)),
        (15, struct.pack("<BffB", 5, math.nan, 0, 6)),
        (15, struct.pack("<BffB", 5, 0, math.nan, 6)),
        (16, struct.pack("<BfBfB", 12, 0, 6, 0, 1)),
        (16, struct.pack("<BfBfB", 12, 0, 6, 0, 21)),
        (18, client.subscription(24, 2)),
    ],
)
def test_out_of_range_changes_nothing(id_: int, arguments: bytes) -> None:
    bench = at_rest()
    before = bench.device.parameters.stored_values()
    assert bench.status(SET, id_, arguments) == BAD_ARGUMENTS
    assert bench.one(READ, id_).arguments == client.DEFAULTS[id_]
    assert bench.device.parameters.stored_values() == before


def test_what_the_device_understands() -> None:
    bench = at_rest()
    for id_ in client.PARAMETER_BYTES:
        assert bench.status(SET, id_, changed(id_)) == 0
    assert bench.device.parameters.stored_values() == {
        "exposure_us": 50_000,
        "magnitude_limit": 6.5,
        "tracking_min_stars": 4,
    }


def test_a_start_forgets_them_and_gives_the_device_its_own_again() -> None:
    store = VolatileStore()
    store.load()
    bench = Bench(unit(autonomous=False), store=store).boot()
    before = bench.device.parameters.stored_values()
    for id_ in client.PARAMETER_BYTES:
        bench.status(SET, id_, changed(id_))
    assert bench.device.parameters.stored_values() != before
    bench.device.power_off()
    bench.run(50)
    bench.device.power_on()
    bench.boot()
    for id_, default in client.DEFAULTS.items():
        assert bench.one(READ, id_).arguments == default
    assert bench.device.parameters.stored_values() == before
    assert bench.subscribed(27, bench.run(2500)) == []


def test_what_is_mapped_is_refused_in_fault_and_all_else_is_kept() -> None:
    bench = at_rest()
    bench.device.enter_fault(FaultCause.COMMANDED)
    assert bench.status(SET, 9, client.camera(0.05)) == NOT_NOW
    assert bench.one(READ, 9).arguments == client.DEFAULTS[9]
    assert bench.status(SET, 13, changed(13)) == 0
    assert bench.one(READ, 13).arguments == changed(13)


def test_image_mode_keeps_a_frame_for_the_histogram() -> None:
    bench = at_rest()
    assert sum(map(sum, client.histogram(bench.telemetry(client.HISTOGRAM)))) == 0
    arguments = struct.pack("<BBHHB", 1, 0, 10, 0, 0)
    assert bench.status(SET, 10, arguments) == 0
    assert bench.status(SET, 10, arguments) == 0  # one is on its way: it serves
    bench.run(600)
    sections = client.histogram(bench.telemetry(client.HISTOGRAM))
    detector = bench.emulator.profile.detector
    assert [sum(section) for section in sections] == [detector.columns * detector.rows // 4] * 4
    assert bench.ask(REQUEST, client.HISTOGRAM, b"\x00")[0].status == BAD_ARGUMENTS
