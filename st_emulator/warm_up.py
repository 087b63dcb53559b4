"""What takes time is done before power comes on: tables loaded, kernels compiled (both are cached)."""

from __future__ import annotations

from .configuration import star_tables
from .emulator import Emulator
from .profile import UnitProfile
from .scenario import Scenario, ScenarioTelecommand, Sky

WARM_UP_S = 2.6


def warm_up(profile: UnitProfile) -> None:
    """Run seconds of a unit in virtual time: lost in space and tracking, so that no first frame is late."""
    star_tables(profile)
    scenario = Scenario(
        sky=Sky(false_spots=1),
        telecommands=[
            ScenarioTelecommand(at_s=0.6, name="function", fields={"function_id": 2, "arguments": {}}),
            ScenarioTelecommand(at_s=0.7, name="ping"),
        ],
    )
    emulator = Emulator(profile, scenario)
    emulator.advance(int(WARM_UP_S * 1e9))
