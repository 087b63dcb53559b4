"""Faults of the memory: by seed, where they may be, what heals them, and stores that outlive the program."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_tests.faults.exercises_memory import STAR, checked, dumped, loaded, reset, self_test
from hil_tests.unit.conftest import Bench, make
from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.scenario import Scenario
from st_emulator.bench.star_tables import star_tables
from st_emulator.device.memories import catalogue_octets, with_upset
from st_emulator.device.store import FileStore
from st_emulator.errors import ConfigurationError
from st_emulator.faults.store import (
    checked_again,
    contents_of,
    image_of,
    unseen_upsets,
)
from st_emulator.faults.store import (
    with_upset as altered,
)
from st_emulator.units.profile import load_unit

PROGRAM, NON_VOLATILE = 4, 2
CHUNK = 1024


def upset(bench: Bench, **settings: Any) -> None:
    bench.emulator.faults.inject({"kind": "memory.bit_upset"} | settings)


def program(bench: Bench) -> bytes:
    return b"".join(dumped(bench, PROGRAM, start, CHUNK) for start in range(0, 131072, CHUNK))


def standing() -> Bench:
    return make(wire={"baud": 4_000_000}).boot()


def test_the_bit_is_the_seeds_and_one() -> None:
    programs = []
    for seed in (1, 1, 2):
        bench = standing()
        upset(bench, memory="program", seed=seed, caught=False)
        programs.append(program(bench))
    assert programs[0] == programs[1] != programs[2]
    stored = program(standing())
    for found in programs:
        (changed,) = [(a, b) for a, b in zip(stored, found, strict=True) if a != b]
        assert (changed[0] ^ changed[1]).bit_count() == 1


@pytest.mark.parametrize("caught", [True, False])
@pytest.mark.parametrize(("memory", "part"), [("program", 64), ("catalogue", 8), ("parameters", 4)])
def test_the_self_test_finds_what_is_caught(memory: str, part: int, caught: bool) -> None:
    bench = standing()
    bench.set_parameters(exposure_us=70_000)
    upset(bench, memory=memory, caught=caught)
    assert self_test(bench) == (part if caught else 0)
    bench.emulator.device.restart(bench.emulator.device.reset_cause)
    bench.run(500)
    assert self_test(bench) == 0, "a start heals, and counts itself in the store"


def test_a_damage_that_is_caught_is_found_beside_one_that_is_not() -> None:
    bench = standing()
    for caught in (False, True, False):
        upset(bench, memory="program", caught=caught)
        upset(bench, memory="catalogue", caught=caught)
    assert self_test(bench) == 64 | 8


def test_two_upsets_of_the_same_bit_are_none() -> None:
    bench = standing()
    for _ in range(2):
        upset(bench, memory="program", address=77, bit=5)
    assert self_test(bench) == 0


def test_the_address_of_a_star() -> None:
    tables = star_tables(load_unit("roja1"))
    catalogue = tables.catalogue
    assert catalogue.hip[STAR // 24] == 26311
    vectors = with_upset(tables, STAR + 8 * 1 + 7, 0).catalogue.unit_vectors
    assert np.argwhere(vectors != catalogue.unit_vectors).tolist() == [[STAR // 24, 1]]
    last = catalogue_octets(tables) - 1
    magnitudes = with_upset(tables, last, 7).catalogue.hp_mag
    assert magnitudes[-1] == -catalogue.hp_mag[-1]
    assert (magnitudes[:-1] == catalogue.hp_mag[:-1]).all()


@pytest.mark.parametrize("octet", range(8))
@pytest.mark.parametrize("axis", range(3))
def test_no_bit_of_a_star_in_view_upsets_the_unit(octet: int, axis: int) -> None:
    """Infinite and huge directions, and none at all: the unit tracks, or finds its attitude anew."""
    bench = make(scenario=Scenario(parameters={"autonomous_start": 1}))
    bench.run(1500)
    for bit in range(8):
        upset(bench, memory="catalogue", address=STAR + 8 * axis + octet, bit=bit, caught=False)
        bench.run(260)
    bench.function("START_ACQUISITION", ack=0)
    bench.run(1500)
    last = bench.of("attitude_report")[-1]
    assert last["valid"]
    assert last["stars_identified"] >= 8
    assert bench.events("FAULT_ENTERED") == []


@pytest.mark.parametrize(
    ("memory", "last"), [("program", 131071), ("parameters", 2047), ("catalogue", 352351)]
)
def test_an_address_outside_is_refused(memory: str, last: int) -> None:
    bench = standing()
    upset(bench, memory=memory, address=last)
    with pytest.raises(
        ConfigurationError, match=rf"fault: memory.bit_upset: address: found {last + 1}; .* from 0 to {last} "
    ):
        upset(bench, memory=memory, address=last + 1)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"memory": "disk"}, r"fault: memory: found 'disk'; allowed is one of 'catalogue', 'parameters'"),
        ({}, r"fault: memory: is missing; allowed is one of 'catalogue', 'parameters', 'program'"),
        ({"memory": "program", "bit": 8}, r"fault: bit: found 8; allowed is a whole number from 0 to 7"),
        ({"memory": "program", "caught": 1}, r"fault: caught: found 1; allowed is true or false"),
        ({"memory": "program", "adress": 1}, r"fault: adress: is not a known key; allowed are kind, start_s"),
        ({"kind": "memory.gone"}, r"fault: kind: found 'memory.gone'; allowed are .*line\.bits_flipped, "),
        (
            {"kind": "memory.upset_while_written", "memory": "ram", "caught": False},
            r"fault: caught = false is",
        ),
        ({"memory": "program", "end_s": 1, "duration_s": 1}, r"fault: give end_s or duration_s, not both"),
    ],
)
def test_wrong_settings(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        upset(standing(), **table)


def test_behind_the_stored_text_nothing_is_struck() -> None:
    bench = standing()
    bench.set_parameters(exposure_us=70_000)
    upset(bench, memory="parameters", address=2000)
    reset(bench)
    assert bench.events("PARAMETER_STORE_INVALID") == []
    assert bench.parameter("exposure_us") == 70_000


def test_a_file_is_struck_as_well(tmp_path: Path) -> None:
    """The next run of the program finds what the fault destroyed, and no more."""
    store_path = tmp_path / "unit.json"
    bench = make(store=FileStore(store_path, "roja1")).boot()
    bench.set_parameters(exposure_us=70_000)
    upset(bench, memory="parameters")
    again = make(store=FileStore(store_path, "roja1"))
    again.run(450)
    assert [event["cause"] for event in again.events("PARAMETER_STORE_INVALID")] == [3]
    assert again.parameter("exposure_us") == 100_000
    once_more = make(store=FileStore(store_path, "roja1"))
    once_more.run(450)
    assert once_more.events("PARAMETER_STORE_INVALID") == []
    assert once_more.parameter("boot_count") == 2


def test_each_bit_of_the_image_is_caught_or_leaves_something_that_can_be_read() -> None:
    profile = load_unit("roja1")
    bench = make(profile)
    bench.run(450)
    bench.set_parameters(exposure_us=70_000, detection_sigma=5.5)
    store, parameters = bench.emulator._store, bench.emulator.device.parameters
    image = store.image()
    assert image is not None
    seen = 0
    for address in range(len(image) - 4):
        unseen = unseen_upsets(image, address, parameters.fits)
        for bit in range(8):
            spoilt = altered(image, address, bit)
            assert contents_of(spoilt) is None, "a check sum finds every single bit"
            if bit in unseen:
                contents = contents_of(checked_again(spoilt))
                assert contents is not None
                assert image_of(contents) != image
                seen += 1
    assert seen > 20


def test_what_is_written_when_the_fault_is_over_is_whole() -> None:
    bench = standing()
    bench.emulator.faults.inject({"kind": "memory.upset_while_written", "duration_s": 0.5})
    assert loaded(bench, 1, 0, bytes(16))[-1] == "completion_success"
    assert dumped(bench, 1, 0, 16) != bytes(16)
    bench.set_parameters(exposure_us=70_000)
    bench.run(600)
    data = bytes(range(16))
    loaded(bench, 1, 0, data)
    assert dumped(bench, 1, 0, 16) == data
    assert checked(bench, 1, 0, 16) == wire.crc16(data)
    bench.set_parameters(exposure_us=70_000)
    reset(bench)
    assert bench.parameter("exposure_us") == 70_000
    assert bench.events("PARAMETER_STORE_INVALID") == []
