"""The runs whose journals are kept here, each driven by an OBC made with struct alone.

``python -m hil_tests.journals.recorded_runs FOLDER [NAME ...]`` records them anew. The kept ones were first
recorded before the rebuild of the unit into a device with dialects, and hold what users saw then; their first
lines still are of that time, for a journal that is recorded over an older one keeps its header. They were
recorded anew when the attitude report grew by the covariance of the rate: every other field of every attitude
report was the same to the last bit but those of time and cycles. Cycle costs that are fitted anew change
those again. That of ``aps_rs`` is of its unit of now, with a rolling shutter and a rate.
"""

from __future__ import annotations

import io
import lzma
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil_tests.unit.conftest import PARAMETER, WIDE, Bench, make, make_can
from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.received import EVENT
from hil_tests.vectors.reference_can import error_record, record, remote_record
from st_emulator.bench.scenario import InertialTrajectory, Scenario, parse_scenario
from st_emulator.device.store import StoreContents, VolatileStore
from st_emulator.protocol.pus.enumerations import StoreInvalidCause
from st_emulator.wire.can.wiring import CanWiring

FOLDER = Path(__file__).parent
EXAMPLES = FOLDER.parents[1] / "examples"
Q = {"q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0}
PATCH = bytes(range(256))
CHECKSUM = wire.crc16(PATCH)

#: (at ms, telecommand, its fields)
Session = list[tuple[float, str, dict[str, Any]]]

EVERYTHING: Session = [
    (100, "ping", {}),  # in BOOT: nobody listens
    (560, "ping", {}),
    (620, "function START_SELF_TEST", {}),
    (700, "function START_ACQUISITION", {}),  # refused
    (1330, "set_time", {"time": (2_000_000_000, 1 << 20)}),
    (1560, "hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 700}]}),
    (1580, "hk_one_shot", {"structure_ids": [1, 2, 3, 4]}),
    (1600, "hk_disable", {"structure_ids": [1]}),
    (1680, "memory_load", {"memory_id": 1, "start_address": 9, "data": PATCH, "checksum": CHECKSUM}),
    (1700, "memory_load", {"memory_id": 1, "start_address": 9, "data": PATCH, "checksum": CHECKSUM ^ 1}),
    (1730, "memory_dump", {"memory_id": 1, "start_address": 9, "length": 256}),
    (1830, "memory_check", {"memory_id": 1, "start_address": 0, "length": 2000}),
    (1850, "parameter_set", {"settings": [{"parameter_id": 1, "value": 80_000}]}),
    (1870, "parameter_report", {"parameter_ids": list(range(1, 24))}),
    (1890, "event_disable", {"event_ids": [EVENT["ATTITUDE_ACQUIRED"], EVENT["IMAGE_CAPTURED"]]}),
    (1910, "event_report_disabled", {}),
    (1930, "function START_ACQUISITION", {}),
    (3930, "function GO_STANDBY", {}),
    (4060, "function TRACK_FROM", Q),
    (4930, "function TRACK_FROM", {**Q, "q_w": 0.5}),
    (4960, "function START_ACQUISITION", {}),
    (5100, "memory_load", {"memory_id": 1, "start_address": 9, "data": PATCH, "checksum": CHECKSUM}),
    (5930, "time_report_rate", {"rate_exponent": 1}),
    (6180, "function CAPTURE_IMAGE", {}),
    (6200, "function CAPTURE_IMAGE", {}),  # busy
    (6680, "function DOWNLOAD_IMAGE", {"transaction_id": 3, "first_part": 1, "parts": 5}),
    (7300, "memory_dump", {"memory_id": 3, "start_address": 0, "length": 64}),
    (7500, "event_enable", {"event_ids": [EVENT["IMAGE_CAPTURED"]]}),
    (7600, "hk_enable", {"structure_ids": [2, 3]}),
    (8000, "function CLEAR_COUNTERS", {}),
    (8680, "function SHUTDOWN", {}),
    (8900, "ping", {}),
]


def play(bench: Bench, session: Session, end_ms: float) -> None:
    """Telecommands at their times, all reports asked for."""
    for at_ms, name, fields in session:
        bench.run_to(at_ms)
        telecommand, _, function = name.partition(" ")
        if function:
            bench.function(function, fields)
        else:
            bench.send(telecommand, fields)
    bench.run_to(end_ms)


def everything(unit: str, **arguments: Any) -> Callable[[io.StringIO], Bench]:
    def run(journal: io.StringIO) -> Bench:
        bench = make(unit, journal=journal, **arguments)
        play(bench, EVERYTHING, 9300)
        return bench

    return run


def scenario(file: str, seconds: float, unit: str = "roja1") -> Callable[[io.StringIO], Bench]:
    def run(journal: io.StringIO) -> Bench:
        text = (EXAMPLES / file).read_text(encoding="utf-8")
        bench = make(unit, journal=journal, scenario=parse_scenario(text, file))
        bench.run_to(seconds * 1000)
        return bench

    return run


def parameter_writes(journal: io.StringIO) -> Bench:
    bench = make(journal=journal)
    values = {
        "exposure_us": 60_000, "detection_sigma": 6.1, "detection_min_pixels": 3,
        "centroid_half_window_px": 3, "magnitude_limit": 6.4, "identification_tolerance_arcsec": 45.5,
        "identification_max_spots": 16, "tracking_rate_deg_s": 0.7, "tracking_tolerance_arcsec": 50,
        "tracking_min_stars": 4, "tracking_max_missed": 2, "blinded_background_dn": 700,
        "aberration_correction": 0, "velocity_x_km_s": 1.5, "velocity_y_km_s": -7.1, "velocity_z_km_s": 0.25,
        "attitude_report": 1, "autonomous_start": 1, "pipelined": 0, "clock_hz": 200_000_000,
        "cache_kib": 8, "line_fill": 2,
    }  # fmt: skip
    session: Session = [
        (
            560 + 20 * number,
            "parameter_set",
            {"settings": [{"parameter_id": PARAMETER[name], "value": value}]},
        )
        for number, (name, value) in enumerate(values.items())
    ]
    every = {"parameter_ids": list(range(1, 24))}
    session += [
        (1100, "parameter_report", every),
        (1130, "parameter_set", {"settings": [{"parameter_id": PARAMETER["exposure_us"], "value": 250_000}]}),
        (1150, "parameter_set", {"settings": [{"parameter_id": PARAMETER["cache_kib"], "value": 5}]}),
        (1160, "memory_dump", {"memory_id": 2, "start_address": 0, "length": 700}),
        (1300, "function START_ACQUISITION", {}),
        (3300, "hk_one_shot", {"structure_ids": [1, 3]}),
        (3600, "parameter_set", {"settings": [{"parameter_id": PARAMETER["attitude_report"], "value": 0}]}),
        (4200, "function RESET", {"kind": 0}),
        (5000, "parameter_report", every),
        (5800, "function RESTORE_DEFAULT_PARAMETERS", {}),
        (5900, "parameter_report", every),
        (7000, "function RESET", {"kind": 1}),
        (8000, "hk_one_shot", {"structure_ids": [1, 2]}),
    ]
    play(bench, session, 8300)
    return bench


def malformed(journal: io.StringIO) -> Bench:
    bench = make(journal=journal).boot()
    ping = bench.packet("ping")
    damaged = [
        b"", b"\x00garbage\xc0", ping[:3], ping[:6], ping[:-1], ping + b"\0",
        ping[:-1] + bytes([ping[-1] ^ 1]), ping[:4] + b"\xff\xff" + ping[6:], bytes(1025),
    ]  # fmt: skip
    for packet in damaged:
        bench.put_packet(packet)
        bench.run(60)
    for change in ((0, 0x38), (0, 0x08), (2, 0x40), (6, 0x1F), (7, 99), (8, 77), (1, 0x55)):
        body = bytearray(bench.packet("ping")[:-2])
        body[change[0]] = change[1]
        bench.put_packet(bytes(body) + wire.crc16(bytes(body)).to_bytes(2, "big"))
        bench.run(60)
    for line in (
        b"\xc0\xdb\x01\xc0",
        b"\xc0\xdb\xc0",
        b"\xdb\xdb\xdb",
        b"\xc0" * 9,
        b"\x55" * 3000 + b"\xc0",
    ):
        bench.put(line)
        bench.run(400 if len(line) > 100 else 60)
    for name, fields in (
        ("hk_one_shot", {"structure_ids": [9]}),
        ("parameter_report", {"parameter_ids": [99]}),
        ("parameter_set", {"settings": [{"parameter_id": 21, "value": 5}]}),
        ("parameter_set", {"settings": [{"parameter_id": 2, "value": 500.0}]}),
        ("memory_dump", {"memory_id": 7, "start_address": 0, "length": 5}),
        ("memory_dump", {"memory_id": 3, "start_address": 0, "length": 5}),
        ("memory_dump", {"memory_id": 1, "start_address": 65_530, "length": 50}),
        ("memory_load", {"memory_id": 2, "start_address": 0, "data": b"\1", "checksum": 0}),
        ("function DOWNLOAD_IMAGE", {"transaction_id": 1, "first_part": 0, "parts": 0}),
        ("hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 1}]}),
        ("event_disable", {"event_ids": [77]}),
    ):
        telecommand, _, function = name.partition(" ")
        if function:
            bench.function(function, fields)
        else:
            bench.send(telecommand, fields)
        bench.run(60)
    bench.send("ping", count=5)
    bench.run(60)
    bench.send("ping", count=9)
    bench.run(60)
    for octet in range(0, 256, 7):  # telecommands split over the line, octet by octet
        bench.put(bytes([octet]))
        bench.run(1)
    frame = wire.slip_frame(bench.packet("ping"))
    for octet in frame:
        bench.put(bytes([octet]))
        bench.run(3)
    bench.put(frame + frame + frame[:4])
    bench.run(100)
    bench.housekeeping(2)
    bench.run(1000)
    return bench


def image(journal: io.StringIO) -> Bench:
    bench = make(journal=journal, wire={"baud": 1_000_000})
    session: Session = [
        (560, "function DOWNLOAD_IMAGE", {"transaction_id": 1, "first_part": 0, "parts": 0}),
        (600, "function CAPTURE_IMAGE", {}),
        (1200, "function DOWNLOAD_IMAGE", {"transaction_id": 2, "first_part": 680, "parts": 0}),
        (1210, "function CAPTURE_IMAGE", {}),
        (1700, "function START_ACQUISITION", {}),
        (3000, "function DOWNLOAD_IMAGE", {"transaction_id": 3, "first_part": 700, "parts": 9}),
        (3100, "function DOWNLOAD_IMAGE", {"transaction_id": 3, "first_part": 0, "parts": 30}),
        (3200, "function ABORT_DOWNLOAD", {}),
        (3300, "memory_check", {"memory_id": 3, "start_address": 0, "length": 30}),
        (3400, "function DOWNLOAD_IMAGE", {"transaction_id": 4, "first_part": 1, "parts": 30}),
        (3500, "function RESET", {"kind": 0}),
        (4500, "function CAPTURE_IMAGE", {}),
        (4510, "function START_SELF_TEST", {}),
        (5600, "function CAPTURE_IMAGE", {}),
        (6200, "function DOWNLOAD_IMAGE", {"transaction_id": 5, "first_part": 1, "parts": 3}),
        (6205, "function SHUTDOWN", {}),
    ]
    play(bench, session, 6700)
    return bench


def slow_processor(journal: io.StringIO) -> Bench:
    bench = make(journal=journal, parameters={"pipelined": 0, "clock_hz": 20_000_000, "autonomous_start": 1})
    session: Session = [
        (4000, "hk_one_shot", {"structure_ids": [1, 3]}),
        (5000, "parameter_set", {"settings": [{"parameter_id": PARAMETER["pipelined"], "value": 1}]}),
        (8000, "function START_ACQUISITION", {}),
        (10000, "hk_one_shot", {"structure_ids": [1, 3]}),
    ]
    play(bench, session, 10500)
    return bench


def full_line(journal: io.StringIO) -> Bench:
    """A slow line whose queue overflows."""
    bench = make(
        journal=journal, wire={"baud": 2400, "status_interval_ms": 250}, parameters={"autonomous_start": 1}
    )
    session: Session = [
        (600, "hk_enable", {"structure_ids": [1, 2, 3, 4]}),
        *(
            (1000 + 300 * n, "memory_dump", {"memory_id": 1, "start_address": 0, "length": 1000})
            for n in range(60)
        ),
        (20000, "function GO_STANDBY", {}),
        (20100, "hk_disable", {"structure_ids": [1, 2, 3, 4]}),
        (230_000, "ping", {}),
    ]
    play(bench, session, 240_000)
    return bench


def damaged_store(journal: io.StringIO) -> Bench:
    class Damaged(VolatileStore):
        fault: StoreInvalidCause | None = StoreInvalidCause.BAD_CHECKSUM

        def load(self) -> tuple[StoreContents, StoreInvalidCause | None]:
            return super().load()[0], self.fault

        def save(self, contents: StoreContents) -> None:
            super().save(contents)
            self.fault = None

    bench = make(journal=journal, store=Damaged(StoreContents({}, 70000)))
    play(bench, [(800, "hk_one_shot", {"structure_ids": [1]}), (900, "function RESET", {"kind": 0})], 2000)
    return bench


def towards_the_sun(journal: io.StringIO) -> Bench:
    sky = Scenario(
        trajectory=InertialTrajectory(ra_deg=297.0, dec_deg=-5.0), parameters={"autonomous_start": 1}
    )
    bench = make(journal=journal, scenario=sky)
    play(bench, [(1000, "set_time", {"time": (2_146_000_000, 0)})], 4000)
    return bench


def on_the_bus(**arguments: Any) -> Callable[[io.StringIO], Bench]:
    def run(journal: io.StringIO) -> Bench:
        bench = make_can(journal=journal, **arguments)
        session: Session = [
            (at_ms, name, fields | ({"parts": 3} if name.endswith("DOWNLOAD_IMAGE") else {}))
            for at_ms, name, fields in EVERYTHING
        ]
        for at_ms, name, fields in session:
            bench.run_to(at_ms)
            if at_ms == 5930:
                bench.put_frame("sync", b"\x07")
                bench.run(5)
                bench.put_frame("time_at_sync", b"\x07" + (2_000_000_100).to_bytes(4, "big") + b"\x40\0\0")
            telecommand, _, function = name.partition(" ")
            if function:
                bench.function(function, fields)
            else:
                bench.send(telecommand, fields)
        bench.run_to(9300)
        return bench

    return run


def bad_frames(journal: io.StringIO) -> Bench:
    bench = make_can(journal=journal)
    bench.boot()
    identifier = bench.peer.telecommand
    for payload in (
        b"", b"\x00", b"\x08abcdefg", b"\x10\x05abcdef", b"\x10\x00abcdef", b"\x1f\xffabcdef", b"\x21abcdefg",
        b"\x30\0\0", b"\x33\0\0", b"\x32\0\0", b"\x40abc", b"\xf0", b"\x03abc", b"\x10\x14abcdef",
    ):  # fmt: skip
        bench.put(record(identifier, payload))
        bench.run(30)
    bench.put(remote_record(identifier, 8))
    bench.put(record(0x123, b"12345678"))
    bench.put(error_record(0x4, bytes([0, 8, 0, 0, 0, 0, 0, 0])))
    bench.put(b"\xff\xff")
    bench.run(1500)
    for payload in (b"", b"\x01", b"\x01\x02"):
        bench.put_frame("sync", payload)
        bench.put_frame("time_at_sync", payload + bytes(7))
        bench.run(40)
    bench.send("ping")
    bench.run(50)
    bench.function("START_ACQUISITION")
    bench.run(2000)
    bench.peer.deaf = True
    bench.run(3000)
    bench.refusing = True
    bench.run(1500)
    bench.refusing = bench.peer.deaf = False
    bench.run(2500)
    bench.send("hk_one_shot", {"structure_ids": [2, 4]})
    bench.run(300)
    return bench


RUNS: dict[str, Callable[[io.StringIO], Bench]] = {
    "roja1-everything": everything("roja1", wire={"baud": 1_000_000}),
    "roja1-115200-baud": everything("roja1"),
    "zy3-everything": everything("zy3"),
    "aps_rs-everything": everything("aps_rs"),
    "science_cam-everything": everything("science_cam"),
    "slew": scenario("slew.toml", 25),
    "overrun": scenario("overrun.toml", 13),
    "parameter-writes": parameter_writes,
    "malformed-input": malformed,
    "image": image,
    "slow-processor": slow_processor,
    "full-line": full_line,
    "damaged-store": damaged_store,
    "towards-the-sun": towards_the_sun,
    "can-classic": on_the_bus(),
    "can-fd": on_the_bus(can=CanWiring(fd=True)),
    "can-29-bits": on_the_bus(can_section=WIDE),
    "can-zy3-node-3": on_the_bus(profile="zy3", can=CanWiring(node=3)),
    "can-bad-frames": bad_frames,
}


def record_run(name: str) -> str:
    """The text of a run's journal."""
    journal = io.StringIO()
    RUNS[name](journal).emulator.close()
    return journal.getvalue()


def main(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or RUNS:
        path = folder / f"{name}.jsonl.xz"
        text = record_run(name)
        if path.exists():
            header, _, _ = lzma.decompress(path.read_bytes()).decode().partition("\n")
            text = header + "\n" + text.partition("\n")[2]
        data = lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME)
        path.write_bytes(data)
        print(f"{name}: {text.count(chr(10))} lines, {len(text)} characters, {len(data)} octets kept")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
