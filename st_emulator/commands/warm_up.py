"""What takes time is done before power comes on: tables loaded, kernels compiled (both are cached)."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from pathlib import Path

from ..bench.emulator import Emulator
from ..bench.scenario import Scenario, ScenarioTelecommand, Sky
from ..bench.star_tables import star_tables
from ..compiled_kernels import keep_compiled_kernels
from ..units.profile import UnitProfile

WARM_UP_S = 2.6
_IN_A_CHILD = (
    "import sys; from st_emulator.units.profile import UnitProfile; "
    "from st_emulator.commands.warm_up import warm_up; "
    "warm_up(UnitProfile.model_validate_json(sys.stdin.read()))"
)
_warm: set[str] = set()


def warm_up(profile: UnitProfile) -> None:
    """Run seconds of a unit in virtual time: lost in space and tracking, so that no first frame is late.

    It is told by PUS, whatever the unit's own dialect is: what takes time is not on the wire. A unit that is
    warm in this process stays so.
    """
    figures = profile.model_dump_json()
    if figures in _warm:
        return
    star_tables(profile)
    in_pus = profile.model_copy(update={"wire": profile.wire.model_copy(update={"dialect": "pus"})})
    scenario = Scenario(
        sky=Sky(false_spots=1),
        telecommands=[
            ScenarioTelecommand(at_s=0.6, name="function", fields={"function_id": 2, "arguments": {}}),
            ScenarioTelecommand(at_s=0.7, name="ping"),
        ],
    )
    emulator = Emulator(in_pus, scenario)
    emulator.advance(int(WARM_UP_S * 1e9))
    with contextlib.suppress(OSError):
        _marker().touch()
    _warm.add(figures)


def _marker() -> Path:
    """Says that the kernels beside it are compiled."""
    return keep_compiled_kernels() / "warmed-up"


def compile_apart(profile: UnitProfile) -> None:
    """Where the kernels are not compiled yet, let a child process do it: the compiler takes 200 MB and gives
    none of it back. What the child leaves undone, :func:`warm_up` does.
    """
    if _marker().exists():
        return
    subprocess.run(
        [sys.executable, "-c", _IN_A_CHILD],
        input=profile.model_dump_json(),
        text=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )
