"""What goes wrong in a test that uses a unit."""

from __future__ import annotations

from typing import NoReturn


class ExpectationError(AssertionError):
    """What was expected of the unit did not come in its time, or came though it must not."""


class UnitDiedError(Exception):
    """The process of a unit has ended while a test used it; the message says what it said last."""


def leave_out(need: str) -> NoReturn:
    """Leave the running test out: it needs something that only an emulated unit has, such as ``a truth``."""
    import pytest

    pytest.skip(f"{LEFT_OUT}{need}")


LEFT_OUT = "left out: needs "
"""How the reason of each test begins that is left out, so that they can be counted."""
