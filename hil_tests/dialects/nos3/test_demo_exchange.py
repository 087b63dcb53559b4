"""The scripted exchange of the demo: every check holds for a good unit, and fails for a bad one."""

from __future__ import annotations

import pytest

from hil_tests.dialects.demo_session import Session
from hil_tests.dialects.nos3.bench import sky, unit
from st_emulator.dialects.nos3.definition import NOS3
from st_emulator.units.profile import UnitProfile


def played(profile: UnitProfile, turned: bool = False) -> Session:
    session = Session(profile, turned=turned, scenario=sky())
    assert NOS3.exchange is not None
    NOS3.exchange(session)
    return session


@pytest.mark.parametrize(
    ("unit_name", "settings"),
    [
        ("roja1", {}),
        ("zy3", {"layout": "readme", "counter": "once"}),
        ("zy3", {"reception": "callback", "quaternion": "tracker_to_inertial", "echo": "every"}),
    ],
)
def test_every_check_holds(unit_name, settings):
    session = played(unit(unit_name, **settings))
    assert len(session.checks) >= 8
    assert [name for name, holds in session.checks.items() if not holds] == []
    assert any("dead" in line or "de ad" in line for line in session.said)


def test_without_attitude_there_is_none_to_check():
    session = played(unit(autonomous=False))
    assert all(session.checks.values())
    assert "valid" not in session.checks


def test_a_disabled_unit():
    session = played(unit(enabled=False, autonomous=False))
    assert session.checks == {"octets from a disabled unit": True}


def test_a_late_reply_and_a_wrong_attitude_are_found():
    session = played(unit("zy3", reply_delay_us=60_000), turned=True)
    failed = {name for name, holds in session.checks.items() if not holds}
    assert failed == {"reply after the echo", "attitude against the truth"}
