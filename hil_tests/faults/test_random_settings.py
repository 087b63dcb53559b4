"""Any settings of faults of the line, the bus and the telemetry, up to three at once, in every language: no
exception that nobody caught, and a unit that goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.dialects.canopen.bench import unit as canopen_unit
from hil_tests.dialects.nos3.bench import unit as nos3_unit
from hil_tests.dialects.nos3.client import command as nos3_command
from hil_tests.dialects.sagitta import client as sagitta_client
from hil_tests.dialects.sagitta.bench import unit as sagitta_unit
from hil_tests.dialects.test_template import FIND, STATUS, frame
from hil_tests.dialects.test_template import UNIT as TEMPLATE_UNIT
from hil_tests.faults.runs import settings_for
from hil_tests.unit.conftest import MS, make
from hil_tests.vectors.reference_can import record
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS
from st_emulator.wire.can.wiring import CanWiring

Unit = Callable[[], tuple[Emulator, Callable[[int], None]]]
"""Makes a unit, and what lets its time go on with a word of an OBC."""
SEAMS = ("line", "bus", "telemetry")
START = Scenario(parameters={"autonomous_start": 1})


def pus(on_can: bool) -> Unit:
    def made() -> tuple[Emulator, Callable[[int], None]]:
        bench = make(scenario=START, **({"can": CanWiring()} if on_can else {}))
        bench.broken = []

        def go(until_ms: int) -> None:
            bench.run_to(until_ms)
            bench.send("ping")
            bench.send("hk_one_shot", {"structure_ids": [1, 2]})

        return bench.emulator, go

    return made


def of(profile: Any, *octets: bytes, can: CanWiring | None = None) -> Unit:
    def made() -> tuple[Emulator, Callable[[int], None]]:
        emulator = Emulator(profile, START, can=can)

        def go(until_ms: int) -> None:
            emulator.advance(until_ms * MS)
            for group in octets:
                emulator.receive(group)

        return emulator, go

    return made


LANGUAGES = {
    "pus": pus(False),
    "pus on CAN": pus(True),
    "sagitta": of(
        sagitta_unit(boot_loader=False),
        sagitta_client.request(
            sagitta_client.SET, sagitta_client.SUBSCRIPTION, sagitta_client.subscription(24)
        ),
        sagitta_client.request(sagitta_client.REQUEST, 37),
    ),
    "nos3": of(nos3_unit(), nos3_command("data"), nos3_command("housekeeping")),
    "canopen": of(
        canopen_unit(),
        record(0, b"\x01\x2c"),
        record(0x62C, b"\x2f\x00\x40\x00\x04\0\0\0"),
        record(0x62C, b"\x40\x02\x40\x06\0\0\0\0"),
        can=CanWiring(),
    ),
    "template": of(TEMPLATE_UNIT, frame(STATUS), frame(FIND)),
}


def any_of(emulator: Emulator) -> st.SearchStrategy[list[dict[str, Any]]]:
    """Those that the unit can have."""
    wire, dialect = "serial" if emulator.can is None else "can", emulator.profile.wire.dialect
    kinds = [
        kind
        for kind in FAULTS.values()
        if kind.seam in SEAMS and wire in kind.wires and kind.spoken_in(dialect)
    ]
    assert len(kinds) > 10
    return st.lists(st.one_of(*map(settings_for, kinds)), min_size=1, max_size=3)


def allowed(table: dict[str, Any], baud: int) -> bool:
    """Whether the line carries it, and its identifier has no more bits than it says."""
    fits = table.get("extended", False) or table.get("identifier", 0) <= 0x7FF
    return fits and table.get("octets_per_s", 0) <= baud / 10


@pytest.mark.parametrize("language", LANGUAGES)
@given(data=st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
def test_nothing_escapes(language: str, data: st.DataObject) -> None:
    emulator, go = LANGUAGES[language]()
    put_in = 0
    for fault in data.draw(any_of(emulator)):
        if allowed(fault, emulator.baud):
            emulator.faults.inject(fault)
            put_in += 1
        else:
            with pytest.raises(ConfigurationError, match=r"more than (the line carries|11 bits)"):
                emulator.faults.inject(fault)
    for until_ms in range(300, 3000, 300):
        go(until_ms)
    for number in range(put_in):
        emulator.faults.clear(number)
    assert not emulator.faults.active()
    go(3300)
    sent = emulator.dialect.messages_sent
    for until_ms in range(3600, 6000, 300):
        go(until_ms)
    assert emulator.dialect.messages_sent > sent
