"""Image capture and download: every byte, every part, whatever else goes on."""

from typing import Any

import numpy as np
import pytest

from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.bench.world_of import scene_of
from st_emulator.errors import ConfigurationError
from st_emulator.protocol.pus.enumerations import FaultCause
from st_emulator.units.profile import UnitProfile, load_unit
from st_emulator.units.validation import validate

from .conftest import MS, SOURCE, Bench, MakeBench

BUSY, OUT_OF_RANGE, ABORTED = 11, 8, 17
PIXELS = 752 * 480
IMAGE_BYTES = 23 + 2 * PIXELS
PARTS = -(-IMAGE_BYTES // 1024)
FAST = {"baud": 4_000_000}
ALL = {"transaction_id": 7, "first_part": 0, "parts": 0}


def captured(new_bench: MakeBench, **arguments: Any) -> Bench:
    bench = new_bench(wire=FAST, **arguments).boot()
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(500)
    assert len(bench.events("IMAGE_CAPTURED")) == 1
    return bench


def parts_of(bench: Bench) -> list[tuple[str, dict[str, Any]]]:
    return [(packet.name, packet.fields) for packet in bench.packets if packet.name.startswith("image_")]


def test_capture_completes_with_the_read_out(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    bench.run_to(1010)
    count = bench.function("CAPTURE_IMAGE")
    readout_end_ms = 1250 + 100 + bench.emulator.profile.timing.readout_ms
    bench.run_to(readout_end_ms - 0.01)
    assert bench.stages(count) == ["acceptance_success", "start_success"]
    bench.run(20)
    assert bench.stages(count)[2:] == ["completion_success"]
    assert bench.events("IMAGE_CAPTURED") == [{"frame_index": 5, "bytes": IMAGE_BYTES}]
    (event,) = [packet for packet in bench.packets if packet.fields.get("event_id") == 15]
    coarse, fine = event.decoded["time"]
    assert coarse * 1e3 + fine * 1e3 / 2**24 == pytest.approx(readout_end_ms, abs=1e-3)


def test_the_image_comes_whole_and_is_the_frame(new_bench: MakeBench) -> None:
    bench = captured(new_bench)
    frame_index = bench.events("IMAGE_CAPTURED")[0]["frame_index"]
    bench.forget()
    count = bench.function("DOWNLOAD_IMAGE", ALL)
    bench.run(4000)
    parts = parts_of(bench)
    assert [fields["part_number"] for _, fields in parts] == list(range(1, PARTS + 1))
    assert [name for name, _ in parts] == ["image_first_part"] + ["image_part"] * (PARTS - 2) + [
        "image_last_part"
    ]
    assert {fields["transaction_id"] for _, fields in parts} == {7}
    assert {len(fields["data"]) for _, fields in parts[:-1]} == {1024}
    data = b"".join(fields["data"] for _, fields in parts)
    assert len(data) == IMAGE_BYTES
    header = wire.decode_image_header(data[:23])
    coarse, fine = header.pop("time")
    assert header == {
        "frame_index": frame_index,
        "width": 752,
        "height": 480,
        "bits": 10,
        "reserved": 0,
        "exposure_us": 100_000,
        "crc": wire.crc16(data[23:]),
    }
    assert coarse * 1e3 + fine * 1e3 / 2**24 == pytest.approx(frame_index * 250 + 50, abs=1e-3)
    pixels = np.frombuffer(data[23:], dtype=">u2").reshape(480, 752)
    emulator = bench.emulator
    scene = scene_of(emulator.profile, Scenario(), emulator.seed, emulator.start_tai_ns)
    frame = scene.frame(frame_index, frame_index * 250 * MS, 100 * MS)
    assert np.array_equal(pixels, frame.full())
    assert pixels.std() > 1
    stages = bench.stages(count)
    assert stages == ["acceptance_success", "start_success"] + ["progress"] * 9 + ["completion_success"]
    steps = [packet.fields["step"] for packet in bench.reports(count) if packet.name == "progress"]
    assert steps == list(range(1, 10))


def test_some_parts_again(new_bench: MakeBench) -> None:
    bench = captured(new_bench)
    for first, number, wanted in (
        (1, 1, [("image_first_part", 1)]),
        (10, 3, [("image_part", 10), ("image_part", 11), ("image_part", 12)]),
        (PARTS, 1, [("image_last_part", PARTS)]),
        (PARTS - 1, 0, [("image_part", PARTS - 1), ("image_last_part", PARTS)]),
        (0, 2, [("image_first_part", 1), ("image_part", 2)]),
    ):
        bench.forget()
        count = bench.function("DOWNLOAD_IMAGE", {"transaction_id": 9, "first_part": first, "parts": number})
        bench.run(100)
        assert [(name, fields["part_number"]) for name, fields in parts_of(bench)] == wanted
        assert bench.stages(count)[-1] == "completion_success"
        asked_for = [packet for packet in bench.packets if packet.name.startswith("image_")]
        assert {packet.decoded["destination_id"] for packet in asked_for} == {SOURCE}
    data = bench.emulator.dialect.image.data
    assert parts_of(bench)[1][1]["data"] == data[1024:2048]
    for first, number in ((PARTS + 1, 0), (1, PARTS + 1), (PARTS, 2), (65535, 65535)):
        count = bench.function("DOWNLOAD_IMAGE", {"transaction_id": 9, "first_part": first, "parts": number})
        bench.run(30)
        assert bench.failure(count) == ("acceptance_failure", OUT_OF_RANGE, 6)


def test_the_image_is_a_memory_too(new_bench: MakeBench) -> None:
    bench = captured(new_bench)
    bench.send("memory_dump", {"memory_id": 3, "start_address": IMAGE_BYTES - 10, "length": 10}, ack=0)
    count = bench.send(
        "memory_load", {"memory_id": 3, "start_address": 0, "data": b"x", "checksum": wire.crc16(b"x")}
    )
    bench.run(30)
    assert bench.of("memory_dump_report")[0]["data"] == bench.emulator.dialect.image.data[-10:]
    assert bench.failure(count) == ("acceptance_failure", 10, 3)


def test_abort(new_bench: MakeBench) -> None:
    bench = captured(new_bench)
    bench.forget()
    download = bench.function("DOWNLOAD_IMAGE", ALL)
    bench.run(100)
    abort = bench.function("ABORT_DOWNLOAD")
    bench.run(200)
    assert bench.failure(download) == ("completion_failure", ABORTED, 0)
    assert bench.stages(abort) == ["acceptance_success", "completion_success"]
    last = parts_of(bench)[-1][1]["part_number"]
    assert 10 < last < PARTS
    assert bench.events("IMAGE_DOWNLOAD_ABORTED") == [{"transaction_id": 7, "part": last}]
    again = bench.function("DOWNLOAD_IMAGE", {"transaction_id": 8, "first_part": last + 1, "parts": 1})
    bench.run(50)
    assert bench.stages(again)[-1] == "completion_success"


def test_one_capture_or_download_at_a_time(new_bench: MakeBench) -> None:
    bench = captured(new_bench)
    before = bench.emulator.dialect.image.data
    download = bench.function("DOWNLOAD_IMAGE", ALL)
    bench.run(50)
    for name, arguments in (("DOWNLOAD_IMAGE", ALL), ("CAPTURE_IMAGE", {})):
        count = bench.function(name, arguments)
        bench.run(30)
        assert bench.failure(count) == ("acceptance_failure", BUSY, 0)
    bench.run(4000)
    assert bench.stages(download)[-1] == "completion_success"
    assert b"".join(fields["data"] for _, fields in parts_of(bench)) == before
    bench.run_to((bench.now_ms // 250 + 1) * 250 + 10)
    capture = bench.function("CAPTURE_IMAGE")
    bench.run(20)
    for name, arguments in (("CAPTURE_IMAGE", {}), ("DOWNLOAD_IMAGE", ALL)):
        count = bench.function(name, arguments)
        bench.run(30)
        assert bench.failure(count) == ("acceptance_failure", BUSY, 0)
    bench.run(500)
    assert bench.stages(capture)[-1] == "completion_success"
    assert bench.emulator.dialect.image.data != before


def test_attitudes_slip_in_between_the_parts(new_bench: MakeBench) -> None:
    bench = new_bench().boot()  # 115200 baud: a part takes 92 ms
    bench.to_mode("TRACKING")
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(600)
    bench.forget()
    bench.function("DOWNLOAD_IMAGE", {"transaction_id": 1, "first_part": 1, "parts": 60}, ack=1)
    bench.run(5000)
    numbers = [fields["part_number"] for _, fields in parts_of(bench)]
    assert len(numbers) > 40
    reports = [packet for packet in bench.packets if packet.name == "attitude_report"]
    assert [packet.fields["frame_index"] for packet in reports] == list(
        range(reports[0].fields["frame_index"], reports[0].fields["frame_index"] + len(reports))
    )
    assert len(reports) >= 19
    for packet in reports:
        coarse, fine = packet.decoded["time"]
        waited_ms = packet.t_ns / MS - (coarse * 1e3 + fine * 1e3 / 2**24)
        # At most 1500 bytes and the part that was just queued are in front, and its own 150.
        assert waited_ms < (1500 + 1100 + 160) * 10 / 115.2
    assert all(packet.fields["valid"] for packet in reports)


def test_a_capture_in_standby_leaves_no_attitude(new_bench: MakeBench) -> None:
    bench = captured(new_bench)
    bench.run(1000)
    assert bench.of("attitude_report") == []
    assert bench.housekeeping(1)["frames_processed"] == 0


def test_a_capture_whose_frame_is_in_flight_dies_with_a_reset(new_bench: MakeBench) -> None:
    bench = new_bench(timing={"boot_ms": 10}).boot()
    bench.run_to(1010)
    count = bench.function("CAPTURE_IMAGE")
    bench.run_to(1250 + 60)  # its frame is being exposed
    bench.function("RESET", {"kind": 0})
    bench.run(500)
    assert bench.failure(count) == ("completion_failure", ABORTED, 0)
    assert bench.events("IMAGE_CAPTURED") == []
    assert bench.emulator.dialect.image.data == b""


def test_a_capture_dies_with_a_self_test(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    bench.run_to(1010)
    capture = bench.function("CAPTURE_IMAGE")
    bench.run_to(1250 + 60)
    test = bench.function("START_SELF_TEST")
    bench.run(800)
    assert bench.failure(capture) == ("completion_failure", ABORTED, 0)
    assert bench.stages(test)[-1] == "completion_success"
    assert bench.events("IMAGE_CAPTURED") == []


class Gaps:
    """A sensor that delivers no frame for a while."""

    def __init__(self, emulator: Emulator, missing: set[int]) -> None:
        self._scene = emulator.device.imaging._source
        self._missing = missing
        emulator.device.imaging._source = self

    def frame(self, frame_index: int, exposure_start_ns: int, exposure_ns: int) -> Any:
        if frame_index in self._missing:
            return None
        return self._scene.frame(frame_index, exposure_start_ns, exposure_ns)


def test_a_capture_waits_for_a_sensor_that_delivers(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    Gaps(bench.emulator, {5, 6})
    bench.run_to(1010)
    count = bench.function("CAPTURE_IMAGE")
    bench.run_to(7 * 250 + 140)
    assert bench.events("IMAGE_CAPTURED") == [{"frame_index": 7, "bytes": IMAGE_BYTES}]
    assert bench.stages(count)[-1] == "completion_success"


def test_a_frame_that_never_came_is_dropped_with_its_reason(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    bench.to_mode("TRACKING")
    first = bench.emulator.device.last_frame_index + 2
    Gaps(bench.emulator, {first})
    bench.run_to((first + 3) * 250)
    assert bench.events("FRAME_DROPPED") == [{"frame_index": first, "cause": 2}]
    by_frame = {fields["frame_index"]: fields for fields in bench.of("attitude_report")}
    dropped = by_frame[first]
    assert dropped["valid"] == 0
    assert dropped["reasons"] == 0x40 | 0x800  # FRAME_DROPPED, NO_FRAME
    assert dropped["latency_us"] == dropped["cycles"] == 0
    assert by_frame[first + 1]["valid"] == 1, "one lost frame is survived"
    assert by_frame[first + 1]["frames_dropped_before"] == 1
    assert bench.housekeeping(1)["frames_dropped"] == 1


def test_no_sensor_fails_the_self_test(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    Gaps(bench.emulator, set(range(100)))
    count = bench.function("START_SELF_TEST")
    bench.run(700)
    assert bench.failure(count) == ("completion_failure", 16, 0x10)
    assert bench.events("SELF_TEST_COMPLETED") == [{"result": 0x10}]
    assert bench.events("FAULT_ENTERED") == [{"cause": 1}]
    assert bench.housekeeping(1)["mode"] == 5
    assert bench.housekeeping(1)["self_test_result"] == 0x10


def test_download_goes_on_in_fault(new_bench: MakeBench) -> None:
    bench = captured(new_bench)
    bench.emulator.device.enter_fault(FaultCause.COMMANDED)
    count = bench.function("DOWNLOAD_IMAGE", ALL)
    bench.run(4000)
    assert bench.stages(count)[-1] == "completion_success"


@pytest.mark.parametrize(
    ("table", "figures", "message"),
    [
        ("detector", {"columns": 8192, "rows": 8192}, "at most 65535 parts"),
        ("timing", {"self_test_ms": 500}, "looks at a frame"),
    ],
)
def test_a_unit_file_whose_figures_cannot_work_is_refused(
    table: str, figures: dict[str, int], message: str
) -> None:
    data = load_unit("roja1").model_dump(mode="json")
    data[table] |= figures
    with pytest.raises(ConfigurationError, match=message) as caught:
        validate(UnitProfile, data, "my_unit.toml")
    assert str(caught.value).startswith(f"my_unit.toml: {table}")


def test_a_download_in_place_of_another_is_alone(bench: Bench) -> None:
    """Room for the next part is looked for once at a time, however many were aborted just before."""
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(600)
    built: list[int] = []
    image = bench.emulator.dialect.image
    send_parts = image._send_parts

    def watched(*arguments: Any) -> None:
        built.append(bench.emulator.now_ns)
        send_parts(*arguments)

    image._send_parts = watched
    for _ in range(5):
        bench.function("DOWNLOAD_IMAGE", {"transaction_id": 1, "first_part": 0, "parts": 0}, ack=0)
        bench.function("ABORT_DOWNLOAD", ack=0)
    bench.function("DOWNLOAD_IMAGE", {"transaction_id": 2, "first_part": 0, "parts": 0}, ack=0)
    bench.run(3000)
    built.clear()
    bench.run(2000)
    assert built
    assert len(built) == len(set(built))
