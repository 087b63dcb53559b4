"""Parameters: read, set, kept through restarts; the store in its file, whole or damaged."""

import json
import math
import os
import signal
import struct
import subprocess
import sys
import time
import tomllib
import zlib
from pathlib import Path
from typing import Any

import pytest

from st_emulator.device.store import FileStore, StoreContents
from st_emulator.errors import ConfigurationError

from .conftest import PARAMETER, Bench, MakeBench


def factory_values() -> dict[str, float]:
    """The unit file's figures, read with nothing of the project."""
    path = Path(__file__).parents[2] / "st_emulator" / "units" / "roja1.toml"
    unit = tomllib.loads(path.read_text())
    return {
        "exposure_us": int(unit["timing"]["exposure_ms"] * 1000),
        "detection_sigma": unit["detection"]["sigma"],
        "detection_min_pixels": unit["detection"]["min_pixels"],
        "centroid_half_window_px": unit["detection"]["centroid_half_window_px"],
        "magnitude_limit": unit["detection"]["magnitude_limit"],
        "identification_tolerance_arcsec": unit["identification"]["tolerance_arcsec"],
        "identification_max_spots": unit["identification"]["max_spots"],
        "tracking_rate_deg_s": unit["tracking"]["rate_deg_s"],
        "tracking_tolerance_arcsec": unit["tracking"]["tolerance_arcsec"],
        "tracking_min_stars": unit["tracking"]["min_stars"],
        "tracking_max_missed": unit["tracking"]["max_missed"],
        "blinded_background_dn": unit["detection"]["blinded_background_dn"],
        "aberration_correction": 1,
        "velocity_x_km_s": 0.0,
        "velocity_y_km_s": 0.0,
        "velocity_z_km_s": 0.0,
        "attitude_report": int(unit["wire"]["attitude_report"]),
        "autonomous_start": 0,
        "pipelined": int(unit["timing"]["pipelined"]),
        "clock_hz": unit["processor"]["clock_hz"],
        "boot_count": 1,
        "cache_kib": unit["processor"]["cache_kib"],
        "line_fill": ["low", "nominal", "high"].index(unit["processor"]["line_fill"]),
    }


FACTORY = factory_values()
CHANGED: dict[str, float] = {
    "exposure_us": 50_000,
    "detection_sigma": 7.25,
    "tracking_min_stars": 4,
    "velocity_y_km_s": -7.5,
    "clock_hz": 200_000_000,
    "cache_kib": 16,
    "line_fill": 2,
}
TRUNCATED, BAD_CHECKSUM, STORE_OUT_OF_RANGE, OTHER_UNIT = 2, 3, 4, 5


def all_parameters(bench: Bench) -> dict[str, float]:
    bench.forget()
    bench.send("parameter_report", {"parameter_ids": list(range(1, 24))}, ack=0)
    bench.run(40)
    (report,) = bench.of("parameter_values")
    names = {number: name for name, number in PARAMETER.items()}
    return {names[item["parameter_id"]]: item["value"] for item in report["values"]}


def as_f32(value: float) -> float:
    return struct.unpack(">f", struct.pack(">f", value))[0]


def assert_is(values: dict[str, float], expected: dict[str, float]) -> None:
    assert values.keys() == expected.keys()
    for name, value in expected.items():
        assert values[name] == (as_f32(value) if isinstance(value, float) else value), name


def test_factory_values_are_those_of_the_unit_file(bench: Bench) -> None:
    assert_is(all_parameters(bench), FACTORY)


def test_set_and_read_in_the_order_asked(bench: Bench) -> None:
    bench.set_parameters(**CHANGED)
    assert bench.events("PARAMETERS_STORED") == [{"count": len(CHANGED)}]
    assert_is(all_parameters(bench), FACTORY | CHANGED)
    bench.forget()
    bench.send("parameter_report", {"parameter_ids": [20, 1, 20]}, ack=0)
    bench.run(30)
    assert bench.of("parameter_values")[0]["values"] == [
        {"parameter_id": 20, "value": 200_000_000},
        {"parameter_id": 1, "value": 50_000},
        {"parameter_id": 20, "value": 200_000_000},
    ]


def test_limits_themselves_are_allowed(bench: Bench) -> None:
    for name, low, high in (("detection_sigma", 3.0, 50.0), ("tracking_rate_deg_s", 0.01, 10.0)):
        for value in (low, high):
            bench.set_parameters(**{name: value})
            assert bench.parameter(name) == as_f32(value)
        for value in (math.nextafter(as_f32(low), 0) - 1e-6, high + 1e-3):
            count = bench.send(
                "parameter_set", {"settings": [{"parameter_id": PARAMETER[name], "value": value}]}
            )
            bench.run(30)
            assert bench.failure(count) == ("acceptance_failure", 8, PARAMETER[name])


def test_only_caches_with_known_costs_are_taken(bench: Bench) -> None:
    for value in (32, 16, 8, 4, 0):
        bench.set_parameters(cache_kib=value)
        assert bench.parameter("cache_kib") == value
    count = bench.send("parameter_set", {"settings": [{"parameter_id": PARAMETER["cache_kib"], "value": 5}]})
    bench.run(30)
    assert bench.failure(count) == ("acceptance_failure", 8, PARAMETER["cache_kib"])
    assert bench.parameter("cache_kib") == 0


@pytest.mark.parametrize("kind", [0, 1])
def test_kept_through_a_reset(bench: Bench, kind: int) -> None:
    bench.set_parameters(**CHANGED)
    bench.function("RESET", {"kind": kind})
    bench.run(500)
    assert_is(all_parameters(bench), FACTORY | CHANGED | {"boot_count": 2})


def test_kept_through_a_restart_of_the_program(new_bench: MakeBench, store_path: Path) -> None:
    bench = new_bench(store=FileStore(store_path, "roja1")).boot()
    bench.set_parameters(**CHANGED)
    again = new_bench(store=FileStore(store_path, "roja1"))
    again.run(420)
    assert again.events("BOOT_COMPLETED") == [{"boot_count": 2, "reset_cause": 0}]
    assert again.events("PARAMETER_STORE_INVALID") == []
    assert_is(all_parameters(again), FACTORY | CHANGED | {"boot_count": 2})


def test_defaults_are_restored_and_stored(new_bench: MakeBench, store_path: Path) -> None:
    bench = new_bench(store=FileStore(store_path, "roja1")).boot()
    bench.set_parameters(**CHANGED)
    bench.forget()
    bench.function("RESTORE_DEFAULT_PARAMETERS", ack=0)
    bench.run(20)
    assert bench.events("PARAMETERS_STORED") == [{"count": len(CHANGED)}]
    assert_is(all_parameters(bench), FACTORY)
    again = new_bench(store=FileStore(store_path, "roja1")).boot()
    assert_is(all_parameters(again), FACTORY | {"boot_count": 2})


def store_text(parameters: dict[str, Any], unit: str = "roja1", boot_count: int = 3) -> str:
    """A whole store, its checksum as the format says: CRC-32 of the contents as JSON with sorted keys."""
    body = {"unit": unit, "parameters": parameters, "boot_count": boot_count}
    crc32 = zlib.crc32(json.dumps(body, sort_keys=True).encode())
    return json.dumps({"format": "st-emulator parameters 1", "crc32": crc32, "contents": body})


GOOD = store_text({"exposure_us": 50_000})
DAMAGES: dict[str, tuple[str, int, int]] = {  # text, cause, boot count afterwards
    "empty": ("", TRUNCATED, 1),
    "cut": (GOOD[:-10], TRUNCATED, 1),
    "not text": ("\udcff\udcfe", TRUNCATED, 1),
    "a digit": (GOOD.replace("50000", "50001"), BAD_CHECKSUM, 1),
    "no object": ("7", BAD_CHECKSUM, 1),
    "other format": (GOOD.replace("parameters 1", "parameters 9"), BAD_CHECKSUM, 1),
    "other unit": (store_text({}, unit="zy3"), OTHER_UNIT, 1),
    "out of range": (store_text({"exposure_us": 99}), STORE_OUT_OF_RANGE, 4),
    "text for a number": (store_text({"exposure_us": "50"}), STORE_OUT_OF_RANGE, 4),
    "unknown name": (store_text({"exposure_s": 1}), STORE_OUT_OF_RANGE, 4),
    "read-only": (store_text({"boot_count": 1}), STORE_OUT_OF_RANGE, 4),
}


def test_a_good_store_is_used(new_bench: MakeBench, store_path: Path) -> None:
    store_path.write_text(GOOD)
    bench = new_bench(store=FileStore(store_path, "roja1")).boot()
    assert bench.parameter("exposure_us") == 50_000
    assert bench.parameter("boot_count") == 4


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_store_gives_factory_values_and_says_so(
    new_bench: MakeBench, store_path: Path, kind: str
) -> None:
    text, cause, boot_count = DAMAGES[kind]
    store_path.write_text(text, errors="surrogateescape")
    bench = new_bench(store=FileStore(store_path, "roja1"))
    bench.run(420)
    assert bench.events("PARAMETER_STORE_INVALID") == [{"cause": cause}]
    bench.quiet()
    assert bench.housekeeping(1)["stored_parameters_valid"] == 0, "of the start, not of now"
    assert_is(all_parameters(bench), FACTORY | {"boot_count": boot_count})
    bench.function("RESET", {"kind": 0}, ack=0)
    bench.run(500)
    assert bench.events("PARAMETER_STORE_INVALID") == [], "the start has written it anew"
    assert bench.housekeeping(1)["stored_parameters_valid"] == 1


def test_self_test_sees_a_damaged_store(new_bench: MakeBench, store_path: Path) -> None:
    bench = new_bench(store=FileStore(store_path, "roja1")).boot()
    store_path.write_text(store_path.read_text()[:-5])
    count = bench.function("START_SELF_TEST")
    bench.run(700)
    assert bench.failure(count) == ("completion_failure", 16, 4)
    assert bench.events("FAULT_ENTERED") == [{"cause": 1}]


def test_boot_count_stops_on_the_wire(new_bench: MakeBench, store_path: Path) -> None:
    store_path.write_text(store_text({}, boot_count=70_000))
    bench = new_bench(store=FileStore(store_path, "roja1")).boot()
    assert bench.parameter("boot_count") == 65535


def test_a_store_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    blocked = tmp_path / "folder.json"
    blocked.mkdir()
    with pytest.raises(ConfigurationError, match=r"folder\.json"):
        FileStore(blocked, "roja1").save(StoreContents())
    assert list(tmp_path.iterdir()) == [blocked], "nothing half written is left"
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="cannot make its folder"):
        FileStore(tmp_path / "file" / "a.json", "roja1")


def test_a_write_replaces_the_file_whole(store_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever write comes last before a kill, the file under its name is the old or the new one."""
    store = FileStore(store_path, "roja1")
    store.save(StoreContents({"exposure_us": 1000}, 1))
    old = store_path.read_bytes()
    replaced: list[tuple[bytes, bytes]] = []
    replace = os.replace

    def watch(source: Path, target: Path) -> None:
        replaced.append((Path(source).read_bytes(), Path(target).read_bytes()))
        replace(source, target)

    monkeypatch.setattr(os, "replace", watch)
    store.save(StoreContents({"exposure_us": 2000}, 2))
    new = store_path.read_bytes()
    assert replaced == [(new, old)], "written whole beside the old one, which stands until the rename"
    assert store.load() == (StoreContents({"exposure_us": 2000}, 2), None)


WRITER = """
import sys
from st_emulator.device.store import FileStore, StoreContents
store = FileStore(sys.argv[1], "roja1")
number = store.load()[0].boot_count
print("ready", flush=True)
while True:
    number += 1
    store.save(StoreContents({"exposure_us": 1000 + number % 1000, "clock_hz": 1000000 + number}, number))
"""


def test_killed_while_it_writes(store_path: Path) -> None:
    numbers = []
    for pause_s in (0.003, 0.011, 0.017, 0.029):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(store_path)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(pause_s)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        contents, fault = FileStore(store_path, "roja1").load()
        assert fault is None
        if contents.boot_count:
            assert contents.parameters == {
                "exposure_us": 1000 + contents.boot_count % 1000,
                "clock_hz": 1_000_000 + contents.boot_count,
            }
        numbers.append(contents.boot_count)
    assert numbers == sorted(numbers)
    assert numbers[-1] > 0


def test_in_force_from_the_next_frame_start_on(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    bench.to_mode("TRACKING")
    bench.run_to((bench.now_ms // 250 + 2) * 250 + 20)
    frame = int(bench.now_ms // 250)
    bench.set_parameters(exposure_us=60_000)  # in the middle of the exposure of this frame
    bench.run_to((frame + 2) * 250)
    bench.set_parameters(attitude_report=0)  # the exposure of frame + 2 has just started
    bench.run(300)
    by_frame = {fields["frame_index"]: fields for fields in bench.of("attitude_report")}
    assert by_frame[frame]["exposure_us"] == 100_000
    assert by_frame[frame + 1]["exposure_us"] == 60_000
    assert frame + 2 in by_frame, "its settings were latched at its start"
    assert frame + 3 not in by_frame
    start_s = (frame + 1) * 0.25
    coarse, fine = by_frame[frame + 1]["mid_exposure_time"]
    assert coarse + fine / 2**24 == pytest.approx(start_s + 0.03, abs=1e-6)
