"""The scripted exchange of the demo: every check holds for a good unit, and fails for a bad one."""

from __future__ import annotations

import operator
from dataclasses import dataclass, field

import pytest

from hil_tests.dialects.nos3.bench import Bench, make, sky, unit
from st_emulator.dialects.nos3.definition import NOS3
from st_emulator.units.profile import UnitProfile

RELATIONS = {"==": operator.eq, "<=": operator.le, ">=": operator.ge}


@dataclass
class Session:
    """The contract's session, on a bench."""

    bench: Bench
    turned: bool = False
    said: list[str] = field(default_factory=list)
    checks: dict[str, bool] = field(default_factory=dict)

    @property
    def profile(self) -> UnitProfile:
        return self.bench.emulator.profile

    @property
    def now_ns(self) -> int:
        return self.bench.now_ns

    def put(self, data: bytes) -> None:
        self.bench.put(data)

    def run(self, ms: float) -> list[tuple[int, bytes]]:
        self.bench.groups.clear()
        self.bench.run(ms)
        return list(self.bench.groups)

    def true_quaternion(self, t_ns: int) -> tuple[float, float, float, float]:
        x, y, z, w = (float(value) for value in self.bench.truth(t_ns))
        return (w, x, y, z) if self.turned else (x, y, z, w)

    def say(self, text: str) -> None:
        self.said.append(text)

    def check(self, name: str, value: float, relation: str, target: float, unit: str) -> None:
        assert name not in self.checks
        self.checks[name] = RELATIONS[relation](value, target)


def played(profile: UnitProfile, turned: bool = False) -> Session:
    session = Session(make(profile, scenario=sky()), turned)
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
