"""The kernels' program and a simulated processor that runs it.

Without the cross compiler these tests are skipped, and say so; where it is required they fail.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.arm_timing.machine import ArmMachine
from tools.calibration.compiler import Build, find_compiler, shared_build

MISSING = (
    "there is no cross compiler for ARM926EJ-S; "
    "on Debian, as root: apt-get install gcc-arm-linux-gnueabi libc6-dev-armel-cross"
)


def compiler_is_required() -> bool:
    """Under CI, and where asked for: a skipped test would hide that nothing was tested."""
    return bool(os.environ.get("CI")) or os.environ.get("ST_EMULATOR_REQUIRE_ARM") == "1"


def require_compiler() -> None:
    """Skip the test where there is no cross compiler, or fail it where there has to be one."""
    if find_compiler() is not None:
        return
    if compiler_is_required():
        pytest.fail(MISSING, pytrace=False)
    pytest.skip(MISSING)


@pytest.fixture(scope="session")
def arm_build() -> Build:
    """Every kernel of firmware_model/arm in one program; built once for all the workers of a test run."""
    require_compiler()
    return shared_build()


@pytest.fixture(scope="session")
def arm_program(arm_build: Build) -> Path:
    """The path of that program."""
    return arm_build.elf


@pytest.fixture(scope="session")
def machine_of_session(arm_program: Path) -> ArmMachine:
    """One processor for the whole run: to make one costs more than most tests."""
    return ArmMachine(arm_program)


@pytest.fixture
def machine(machine_of_session: ArmMachine) -> Iterator[ArmMachine]:
    """The processor with its program loaded, memory free and caches empty."""
    machine_of_session.release()
    machine_of_session.flush_caches()
    yield machine_of_session
    machine_of_session.release()
