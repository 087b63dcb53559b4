"""The scripted exchange of the demo: what a driver does, for people to look at."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...clock import NS_PER_MS
from ...protocol.nos3.messages import LAYOUTS, Layout, encode_command
from ...protocol.nos3.quantisation import STEP, component_of
from ...units.validation import validate
from ..dialect import DemoSession
from .settings import Nos3Settings

DRIVER_WAITS_MS = 50.0
ABERRATION_ARCSEC = 20.6  # of a unit at rest to the Earth's orbit; the wire has no time to correct it by
UNIT_ARCSEC = 45.0  # ASSUMED: three sigma about the boresight of a field of 6 deg with five stars of 0.04 px
SEARCHES = 40
AGE_MS = 1000  # the attitude is not older; the wire has no time that says how old it is
AGE_STEPS = 100


@dataclass(frozen=True)
class Answered:
    """What came for one command; times in ms from the put of its first octet, NaN when it did not come."""

    echoed: bool
    echo_ms: float
    reply_ms: float
    reply: bytes
    values: dict[str, int] | None


class Driver:
    """A driver that asks and waits, as the real one does."""

    def __init__(self, session: DemoSession, layout: Layout) -> None:
        self._session = session
        self._layout = layout

    def exchange(self, octets: bytes) -> list[tuple[int, int]]:
        """Put octets; returns what comes: (virtual time at which its group had left, octet) each."""
        self._session.put(octets)
        return [(t_ns, octet) for t_ns, group in self._session.run(2 * DRIVER_WAITS_MS) for octet in group]

    def ask(self, name: str, payload: int = 0) -> Answered:
        """One command, and its echo and reply."""
        command = encode_command(self._layout, name, payload)
        definition = self._layout.by_name(name)
        assert definition is not None
        start_ns = self._session.now_ns
        came = self.exchange(command)
        octets = bytes(octet for _, octet in came)
        reply = octets[len(command) :]
        echoed = octets[: len(command)] == command

        def at_ms(count: int) -> float:
            return (came[count - 1][0] - start_ns) / NS_PER_MS if 0 < count <= len(came) else math.nan

        echo_ms = at_ms(len(command))
        reply_ms = at_ms(len(octets)) if reply else math.nan
        values = definition.reply.decode(reply) if definition.reply is not None else None
        self._session.say(
            f"{name}: sent {command.hex(' ')}, echo {octets[: len(command)].hex(' ') or 'none'}"
        )
        if reply:
            self._session.say(f"  reply {reply.hex(' ')}: {values}")
        return Answered(echoed, echo_ms, reply_ms, reply, values)


def exchange(session: DemoSession) -> None:
    """Boot, ask, garble, count, and compare the attitude with the truth."""
    settings = validate(Nos3Settings, session.profile.dialects.get("nos3", {}), "dialects.nos3")
    layout = LAYOUTS[settings.layout]
    driver = Driver(session, layout)
    if not settings.enabled:
        session.say("the unit is disabled: it answers nothing")
        came = driver.exchange(encode_command(layout, "housekeeping"))
        session.check("octets from a disabled unit", len(came), "==", 0, "")
        return
    boot_ms = session.profile.timing.boot_ms - session.now_ns / NS_PER_MS
    if boot_ms > 0:
        session.say(f"the unit boots for {boot_ms:g} ms more: what comes in now is lost")
        session.put(encode_command(layout, "housekeeping"))
        came_early = session.run(boot_ms)
        session.check("octets from a unit that boots", len(came_early), "==", 0, "")
        session.run(20)
    first = driver.ask("housekeeping")
    session.check("first command echoed", int(first.echoed), "==", 1, "")
    session.check("echo after", first.echo_ms, "<=", DRIVER_WAITS_MS, "ms")
    session.check("reply after the echo", first.reply_ms - first.echo_ms, "<=", DRIVER_WAITS_MS, "ms")
    _garble(session, driver, layout)
    second = driver.ask("housekeeping")
    counts = [(item.values or {}).get("count", -1) for item in (first, second)]
    session.check("count of the second housekeeping", counts[1], "==", _second_count(counts[0], settings), "")
    if settings.autonomous:
        _attitude(session, driver, settings)


def _second_count(first: int, settings: Nos3Settings) -> int:
    """Two commands later: what is garbled counts nothing, its own command 1 before its reply."""
    return first + (2 if settings.counter == "twice" else 1)


def _garble(session: DemoSession, driver: Driver, layout: Layout) -> None:
    command = encode_command(layout, "housekeeping")
    session.say("a command with a wrong trailer: silence")
    came = driver.exchange(command[:-1] + b"\x00")
    session.check("octets for a wrong trailer", len(came), "==", 0, "")


def _attitude(session: DemoSession, driver: Driver, settings: Nos3Settings) -> None:
    session.say("the unit looks for its attitude by itself; the driver asks until it is valid")
    for _ in range(SEARCHES):
        answered = driver.ask("data")
        if answered.values is not None and answered.values["valid"]:
            break
    values = answered.values or {}
    session.check("valid", values.get("valid", 0), "==", 1, "")
    if not values.get("valid"):
        return
    x, y, z, w = (component_of(values[f"q{n}"]) + STEP / 2 for n in range(4))
    sent = (x, y, z, w) if settings.quaternion == "inertial_to_tracker" else (-x, -y, -z, w)
    now_ns = session.now_ns
    off = min(
        _angle_arcsec(sent, session.true_quaternion(max(0, now_ns - step * AGE_MS * NS_PER_MS // AGE_STEPS)))
        for step in range(AGE_STEPS + 1)
    )
    # Half a step in each component, doubled from quaternion to angle: 4 components make STEP * 2.
    quantisation_arcsec = math.degrees(2 * STEP) * 3600
    session.say(
        f"16 bits a component are good to {quantisation_arcsec:.1f} arcsec at worst (half a step each)"
    )
    session.check(
        "attitude against the truth",
        off,
        "<=",
        quantisation_arcsec + ABERRATION_ARCSEC + UNIT_ARCSEC,
        "arcsec",
    )


def _angle_arcsec(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Angle between two attitudes; the first need not be normalised."""
    norm = math.sqrt(sum(value * value for value in a))
    ax, ay, az, aw = (value / norm for value in a)
    bx, by, bz, bw = b
    # The vector part of a times the inverse of b: exact for small angles, where an arc cosine is not.
    vector = (
        aw * bx - bw * ax + ay * bz - az * by,
        aw * by - bw * ay + az * bx - ax * bz,
        aw * bz - bw * az + ax * by - ay * bx,
    )
    return math.degrees(2 * math.asin(min(1.0, math.sqrt(sum(part * part for part in vector))))) * 3600
