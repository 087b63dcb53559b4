"""A telecommand that is registered is served, and what is served is registered."""

from __future__ import annotations

import inspect

import pytest

from st_emulator.device import commands
from st_emulator.device.star_tracker import StarTracker
from st_emulator.dialects.pus.dialect import SERVED
from st_emulator.dialects.pus.services import functions
from st_emulator.dialects.pus.services.functions import COMMANDED, OWN_MODES, allowed_modes
from st_emulator.firmware_model.modes import Mode
from st_emulator.protocol import REGISTRY
from st_emulator.protocol.pus.enumerations import FunctionId

from .conftest import Bench


def test_every_registered_telecommand_is_served() -> None:
    assert set(SERVED) == {message.name for message in REGISTRY.telecommands()}


def test_every_function_is_a_command_or_the_languages_own() -> None:
    assert set(COMMANDED) | set(OWN_MODES) == set(FunctionId)
    assert not set(COMMANDED) & set(OWN_MODES)


def test_each_service_is_the_twin_of_its_messages() -> None:
    for name, served in SERVED.items():
        module = inspect.getmodule(served.check)
        assert module is not None
        twin = module.__name__.replace("st_emulator.dialects.pus", "st_emulator.protocol.pus")
        message = REGISTRY.by_name(name)
        (service,) = [item for item in REGISTRY.services if item.number == message.service]
        defined = inspect.getmodule(__import__(twin, fromlist=["SERVICE"]))
        assert defined is not None
        assert service == defined.SERVICE, name


@pytest.mark.parametrize("kind", commands.Command.__args__, ids=lambda kind: kind.__name__)
def test_every_command_of_the_device_has_its_modes(kind: type) -> None:
    modes = commands.modes_of(kind)
    assert modes
    assert set(modes) <= set(commands.LISTENING)
    assert kind in commands.COMMAND_MODES or kind in commands.MODE_EVENTS
    assert kind.__name__ in inspect.getsource(StarTracker.execute), "and is executed"


def test_the_mode_of_functions_is_that_of_their_commands() -> None:
    running = (Mode.STANDBY, Mode.LOST_IN_SPACE, Mode.TRACKING, Mode.RATE_ONLY)
    assert allowed_modes(FunctionId.GO_STANDBY) == running
    assert Mode.SELF_TEST not in allowed_modes(FunctionId.CAPTURE_IMAGE)
    assert functions.allowed_modes(FunctionId.ABORT_DOWNLOAD) == commands.LISTENING


def test_one_without_a_service_is_refused_and_the_unit_lives(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a registry would have it that is ahead of the unit."""
    monkeypatch.delitem(bench.emulator.dialect.receiver._served, "memory_dump")
    count = bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 3})
    bench.run(50)
    assert bench.failure(count) == ("acceptance_failure", 5, 6 * 256 + 5)
    count = bench.send("ping")
    bench.run(50)
    assert bench.stages(count)[-1] == "completion_success"


def test_a_unit_serves_each_of_the_table(bench: Bench) -> None:
    assert set(bench.emulator.dialect.receiver._served) == set(SERVED)
