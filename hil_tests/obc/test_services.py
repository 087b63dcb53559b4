"""The unit's services as calls, against a unit made with struct."""

import struct
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest

from st_emulator.obc import (
    CucTime,
    DownloadError,
    Mode,
    Obc,
    TelecommandTimeout,
    TelemetryTimeout,
    VerificationError,
)

FUNCTION = (8, 1)


def test_ping_measures_the_round_trip(obc: Obc, unit: Any) -> None:
    def handle(request: Any) -> None:
        unit.report(request, 1)
        unit.send(17, 2, after_ms=4)
        unit.report(request, 7, after_ms=90)

    unit.handlers[(17, 1)] = handle
    assert obc.ping() == pytest.approx(0.005)


@pytest.mark.parametrize(
    "now",
    [
        datetime(2026, 5, 1, 12, tzinfo=UTC),
        datetime(2026, 5, 1, 14, tzinfo=timezone(timedelta(hours=2))),
        # 24,957 days from 1958-01-01 to 2026-05-01; 37 leap seconds
        (24_957 * 86_400 + 43_200 + 37) * 1_000_000_000,
        CucTime(24_957 * 86_400 + 43_200 + 37, 0),
    ],
    ids=["utc", "another zone", "nanoseconds", "cuc"],
)
def test_set_time_sends_tai(obc: Obc, unit: Any, now: Any) -> None:
    unit.answer((9, 128))
    obc.set_time(now)
    assert unit.requests[0].data == struct.pack(">IBH", 24_957 * 86_400 + 43_200 + 37, 0, 0)


def test_set_time_without_a_time_sends_the_readers(obc: Obc, unit: Any) -> None:
    unit.answer((9, 128))
    obc.wait(1.5)
    obc.set_time()
    # The stepped reader's epoch is 2026-01-01 (24,837 days after 1958-01-01).
    assert unit.requests[0].data == struct.pack(">IBH", 24_837 * 86_400 + 37 + 1, 0x80, 0)


def test_set_time_wants_a_time_zone(obc: Obc) -> None:
    with pytest.raises(ValueError, match="time zone"):
        obc.set_time(datetime(2026, 5, 1))


def test_parameters_by_name(obc: Obc, unit: Any) -> None:
    def values(request: Any) -> None:
        unit.send(20, 2, b"\x02" + struct.pack(">HIHf", 1, 100_000, 2, 5.5))

    unit.answer((20, 1), values)
    assert obc.parameters(["exposure_us", "detection_sigma"]) == {
        "exposure_us": 100_000,
        "detection_sigma": 5.5,
    }
    assert unit.requests[0].data == struct.pack(">BHH", 2, 1, 2)


def test_set_parameters_in_one_telecommand(obc: Obc, unit: Any) -> None:
    unit.answer((20, 3))
    obc.set_parameters({"tracking_min_stars": 4, "magnitude_limit": 6.5})
    assert unit.requests[0].data == struct.pack(">BHBHf", 2, 10, 4, 5, 6.5)


def test_housekeeping_once(obc: Obc, unit: Any) -> None:
    unit.mode = 3
    unit.answer((3, 27), unit.status)
    values = obc.housekeeping("STATUS")
    assert unit.requests[0].data == b"\x01\x01"
    assert (values["mode"], values["boot_count"], values["temperature_cdeg"]) == (3, 3, -250)
    assert obc.mode() is Mode.LOST_IN_SPACE


def test_an_older_report_is_not_taken_for_the_answer(obc: Obc, unit: Any) -> None:
    unit.mode = 3
    unit.status()
    obc.wait(0.01)
    unit.mode = 4
    unit.answer((3, 27), unit.status)
    assert obc.mode() is Mode.TRACKING


def test_periodic_housekeeping(obc: Obc, unit: Any) -> None:
    for subservice in (5, 6, 31):
        unit.answer((3, subservice))
    obc.enable_housekeeping("timing", 0.5)
    obc.disable_housekeeping("timing")
    assert [(request.type, request.data) for request in unit.requests] == [
        ((3, 31), struct.pack(">BBI", 1, 3, 500)),
        ((3, 5), b"\x01\x03"),
        ((3, 6), b"\x01\x03"),
    ]


def test_events_on_and_off(obc: Obc, unit: Any) -> None:
    unit.answer((5, 5))
    unit.answer((5, 6))
    unit.answer((5, 7), lambda request: unit.send(5, 8, struct.pack(">BHH", 2, 4, 5)))
    obc.enable_events("MODE_CHANGED")
    obc.disable_events("frame-overran", 5)
    assert obc.disabled_events() == ["FRAME_OVERRAN", "FRAME_DROPPED"]
    assert [request.data for request in unit.requests[:2]] == [b"\x01\x00\x02", b"\x02\x00\x04\x00\x05"]


def test_reset_waits_for_the_boot_event(obc: Obc, unit: Any) -> None:
    def handle(request: Any) -> None:
        unit.report(request, 1)
        unit.count = 0
        unit.event(1, struct.pack(">HB", 9, 1), after_ms=500)

    unit.handlers[FUNCTION] = handle
    event = obc.reset("warm")
    assert (event.name, event.data["boot_count"], event.data["reset_cause"]) == ("BOOT_COMPLETED", 9, 1)
    assert unit.requests[0].data == b"\x04\x00"


# Waiting for telemetry


def test_waiting_finds_only_what_comes_after_the_call(obc: Obc, unit: Any) -> None:
    unit.attitude(frame=1)
    obc.wait(0.01)
    unit.attitude(frame=2, after_ms=20)
    assert obc.next("attitude_report").fields["frame_index"] == 2


def test_a_mark_reaches_back(obc: Obc, unit: Any) -> None:
    mark = obc.mark()
    unit.event(6, struct.pack(">II", 5, 2), severity=2)
    obc.wait(0.01)
    event = obc.wait_for_event("TRACKING_LOST", since=mark)
    assert (event.name, event.severity.name, event.data) == (
        "TRACKING_LOST",
        "LOW",
        {"frame_index": 5, "reasons": 2},
    )


def test_a_predicate_chooses(obc: Obc, unit: Any) -> None:
    for frame in range(5):
        unit.attitude(frame=frame, valid=int(frame == 3), after_ms=10 * frame)
    found = obc.wait_for("attitude_report", lambda telemetry: telemetry.fields["valid"])
    assert found.fields["frame_index"] == 3


def test_waiting_in_vain_says_what_came_instead(obc: Obc, unit: Any) -> None:
    unit.attitude(valid=0)
    with pytest.raises(
        TelemetryTimeout, match=r"attitude_report: did not come within 0.5 s; 1 came, none as wanted"
    ):
        obc.wait_for("attitude_report", lambda telemetry: telemetry.fields["valid"], 0.5)
    with pytest.raises(TelemetryTimeout, match="none came"):
        obc.next("pong", 0.5)
    with pytest.raises(TelemetryTimeout, match="event FAULT_ENTERED"):
        obc.wait_for_event("FAULT_ENTERED", 0.5)


def test_the_mode_is_waited_for_by_event(obc: Obc, unit: Any) -> None:
    unit.answer((3, 27), unit.status)
    unit.event(2, struct.pack(">BBB", 3, 4, 1), after_ms=1500)
    assert obc.wait_for_mode("TRACKING", timeout_s=2) == pytest.approx(1.501, abs=0.002)


def test_the_mode_that_is_there_instead_is_named(obc: Obc, unit: Any) -> None:
    unit.answer((3, 27), unit.status)
    with pytest.raises(
        TelemetryTimeout, match=r"mode TRACKING: did not come within 1 s; the mode is STANDBY"
    ):
        obc.wait_for_mode("TRACKING", 1)


def test_the_report_of_an_earlier_frame_does_not_take_the_mode_back(obc: Obc, unit: Any) -> None:
    at = [struct.pack(">IBH", 1000 + seconds, 0, 0) for seconds in range(4)]
    unit.attitude(mode=4, time=at[0])
    unit.event(2, struct.pack(">BBB", 4, 2, 1), time=at[2])
    unit.attitude(mode=4, time=at[1])
    obc.wait(0.01)
    assert obc.unit.mode is Mode.STANDBY
    unit.attitude(mode=3, time=at[3])
    obc.wait(0.01)
    assert obc.unit.mode is Mode.LOST_IN_SPACE


def test_a_set_time_does_not_freeze_the_mode(obc: Obc, unit: Any) -> None:
    late, early = (struct.pack(">IBH", seconds, 0, 0) for seconds in (5000, 100))
    unit.event(2, struct.pack(">BBB", 2, 3, 1), time=late)
    unit.event(12, late + early, time=early)
    unit.attitude(mode=4, time=struct.pack(">IBH", 101, 0, 0))
    obc.wait(0.01)
    assert obc.unit.mode is Mode.TRACKING


# Memory


def test_a_long_load_goes_in_pieces(obc: Obc, unit: Any, wire: Any) -> None:
    unit.answer((6, 2))
    data = bytes(range(256)) + b"rest"
    obc.memory_load("RAM", 0x1000, data)
    assert [request.data for request in unit.requests] == [
        struct.pack(">BIH", 1, 0x1000, 256) + data[:256] + struct.pack(">H", wire.crc16(data[:256])),
        struct.pack(">BIH", 1, 0x1100, 4) + b"rest" + struct.pack(">H", wire.crc16(b"rest")),
    ]


def dump_from(unit: Any, wire: Any, contents: bytes, spoil: int = 0) -> None:
    def dump(request: Any) -> None:
        memory, start, length = struct.unpack(">BIH", request.data)
        data = contents[start : start + length]
        report = struct.pack(">BIH", memory, start, len(data)) + data
        unit.send(6, 6, report + struct.pack(">H", wire.crc16(data) ^ spoil))

    unit.answer((6, 5), dump)


def test_a_long_dump_comes_in_pieces(obc: Obc, unit: Any, wire: Any) -> None:
    contents = bytes(n * 7 % 256 for n in range(3000))
    dump_from(unit, wire, contents)
    assert obc.memory_dump("RAM", 100, 2500) == contents[100:2600]


def test_a_dump_with_a_wrong_checksum_is_refused(obc: Obc, unit: Any, wire: Any) -> None:
    dump_from(unit, wire, bytes(100), spoil=1)
    with pytest.raises(DownloadError, match="memory NON_VOLATILE at 10: 20 of 20 bytes, checksum"):
        obc.memory_dump("NON_VOLATILE", 10, 20)


def test_memory_check(obc: Obc, unit: Any) -> None:
    unit.answer((6, 9), lambda request: unit.send(6, 10, request.data + b"\xab\xcd"))
    assert obc.memory_check("IMAGE", 5, 1000) == 0xABCD


# Images


class Camera:
    """The image download of a unit: parts, of which some get lost the first time they are sent."""

    def __init__(self, unit: Any, wire: Any, width: int, height: int, part_bytes: int) -> None:
        self.unit = unit
        self.pixels = (
            np.arange(width * height, dtype=np.uint32).reshape(height, width).astype(np.uint16) * 257
        )
        body = b"".join(struct.pack(">H", value) for value in self.pixels.ravel().tolist())
        header = struct.pack(">IHHBB", 321, width, height, 12, 0) + wire.CUC
        header += struct.pack(">IH", 100_000, wire.crc16(body))
        data = header + body
        self.parts = [data[n : n + part_bytes] for n in range(0, len(data), part_bytes)]
        self.lost: dict[int, int] = {}
        self.asked: list[tuple[int, int]] = []
        self.complete = True
        unit.handlers[FUNCTION] = self.handle

    def handle(self, request: Any) -> None:
        function, transaction, first, count = struct.unpack(">BHHH", request.data)
        assert function == 6
        self.asked.append((first, count))
        self.unit.report(request, 1)
        self.unit.report(request, 3)
        start = max(first, 1)
        last = len(self.parts) if count == 0 else min(start + count - 1, len(self.parts))
        for place, number in enumerate(range(start, last + 1)):
            subservice = 1 if number == 1 else 3 if number == len(self.parts) else 2
            data = struct.pack(">HH", transaction, number) + self.parts[number - 1]
            if self.lost.get(number, 0):
                self.lost[number] -= 1
                self.unit.count += 1
                continue
            self.unit.send(13, subservice, data, after_ms=100 * place)
        if self.complete:
            self.unit.report(request, 7, after_ms=100 * (last - start) + 1)


def test_an_image_comes_whole(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 20, 30, 100)
    told: list[tuple[int, int | None]] = []
    image = obc.fetch_image(progress=lambda received, expected: told.append((received, expected)))
    assert image.pixels.dtype == np.uint16
    assert np.array_equal(image.pixels, camera.pixels)
    assert (image.frame_index, image.bits, image.exposure_us) == (321, 12, 100_000)
    assert image.time == CucTime(2_000_000_000, 1 << 23)
    assert camera.asked == [(0, 0)]
    assert told[0] == (100, 1223)
    assert told[-1] == (1223, 1223)


def test_a_download_longer_than_the_time_limit_lives_on_its_parts(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 40, 40, 100)
    assert len(camera.parts) * 0.1 > 3
    assert np.array_equal(obc.download_image(timeout_s=0.5), camera.pixels)


def test_lost_parts_are_asked_for_again(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 20, 30, 100)
    camera.lost = {1: 1, 4: 2, 5: 1, 6: 1, 9: 1}
    assert np.array_equal(obc.download_image(), camera.pixels)
    assert camera.asked == [(0, 0), (1, 1), (4, 3), (9, 1), (4, 1)]


def test_a_lost_end_is_asked_for_again(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 20, 30, 100)
    camera.lost = {12: 1, 13: 1}
    assert np.array_equal(obc.download_image(), camera.pixels)
    assert camera.asked == [(0, 0), (12, 0)]


def test_a_lost_completion_report_costs_no_image(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 20, 30, 100)
    camera.complete = False
    assert np.array_equal(obc.download_image(timeout_s=1), camera.pixels)


def test_an_image_in_one_part(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 4, 3, 1000)
    assert np.array_equal(obc.download_image(), camera.pixels)
    assert camera.asked == [(0, 0)]


def test_parts_that_never_come_are_named(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 20, 30, 100)
    camera.lost = {3: 99, 7: 99, 8: 99}
    with pytest.raises(DownloadError, match=r"parts missing: 3, 7\.\.8"):
        obc.download_image()
    assert len(camera.asked) == 1 + 4 * 2


def test_damaged_pixels_are_refused(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 20, 30, 100)
    camera.parts[5] = bytes(100)
    with pytest.raises(DownloadError, match=r"checksum 0x[0-9A-F]{4} of the pixels, the header says 0x"):
        obc.download_image()


def test_parts_of_an_earlier_download_are_not_taken(obc: Obc, unit: Any, wire: Any) -> None:
    camera = Camera(unit, wire, 20, 30, 100)
    obc.download_image()
    stale = struct.pack(">HH", 1, 2) + bytes(100)
    unit.send(13, 2, stale, after_ms=1000)
    assert np.array_equal(obc.download_image(), camera.pixels)


def test_no_image_is_a_failure(obc: Obc, unit: Any) -> None:
    unit.handlers[FUNCTION] = lambda request: unit.fail(request, 4, 12)
    with pytest.raises(VerificationError, match="NO_IMAGE"):
        obc.download_image()


def test_a_silent_unit_is_named(obc: Obc) -> None:
    with pytest.raises(TelecommandTimeout, match=r"DOWNLOAD_IMAGE.*acceptance report"):
        obc.download_image(timeout_s=0.5)
