"""Compiled kernels are kept for the tests too, which call many of them directly.

Tests that need a real vcan0 (marker `vcan`): where there is none they fail or are skipped, and say why.
"""

from __future__ import annotations

import os
import socket

import pytest
from hypothesis import HealthCheck, settings

from st_emulator.compiled_kernels import keep_compiled_kernels

# How fast the computer is, and what else it does, decides nothing here.
settings.register_profile("any speed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any speed")
keep_compiled_kernels()  # the folder of the sources as they are now, before the tests import them

MISSING = "there is no vcan0 here: ./tools/vcan .venv/bin/python -m pytest -m vcan runs these tests with one"


def has_vcan0() -> bool:
    """Whether frames can be sent on an interface of that name."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind(("vcan0",))
            return bus.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0  # ENETDOWN: it is not up
    except OSError:
        return False


def vcan0_is_required() -> bool:
    """Under CI, and where asked for: a skipped test would hide that nothing was tested."""
    return bool(os.environ.get("CI")) or os.environ.get("ST_EMULATOR_REQUIRE_VCAN") == "1"


def pytest_runtest_setup(item: pytest.Item) -> None:
    keep_compiled_kernels()
    if item.get_closest_marker("vcan") is None or has_vcan0():
        return
    if vcan0_is_required():
        pytest.fail(MISSING, pytrace=False)
    pytest.skip(MISSING)
