"""``st-emulator demo --dialect NAME``: a scripted exchange with a unit that speaks a dialect, in virtual
time."""

from __future__ import annotations

from typing import Literal

from rich.console import Console
from rich.markup import escape

from ..bench.emulator import Emulator
from ..bench.scenario import InertialTrajectory, Scenario
from ..clock import NS_PER_MS, NS_PER_S
from ..dialects.registry import dialect_of, with_dialect
from ..errors import ConfigurationError
from ..protocol.can.frames import RecordDecoder
from ..report import Check, all_hold, check, require_json_path, show_checks, show_figures, write_json
from ..units.profile import UnitProfile, load_unit
from ..wire.can.wiring import CanWiring

POINTING = InertialTrajectory(ra_deg=84.0, dec_deg=-1.5, roll_deg=20.0)  # Orion
MOST_SHOWN_BYTES = 48


class Session:
    """One unit in virtual time, its octets shown (see :class:`~st_emulator.dialects.dialect.DemoSession`).

    ``truncated`` octets of a long message are counted, not shown; a stretch of the same kind of messages is
    the exchange's to sum up by ``say``.
    """

    def __init__(self, profile: UnitProfile, can: bool, seed: int, console: Console) -> None:
        self._console = console
        self._can = can
        self._sent: list[tuple[int, bytes]] = []
        self.checks: list[Check] = []
        self.received_bytes = self.sent_bytes = 0
        self.emulator = Emulator(
            profile,
            Scenario(trajectory=POINTING, seed=seed),
            transmit=self._transmitted,
            can=CanWiring() if can else None,
        )

    @property
    def profile(self) -> UnitProfile:
        return self.emulator.profile

    @property
    def now_ns(self) -> int:
        return self.emulator.now_ns

    def _transmitted(self, data: bytes, t_ns: int) -> None:
        self._sent.append((t_ns, data))
        self.sent_bytes += len(data)

    def put(self, data: bytes) -> None:
        self._show(self.now_ns, "OBC ", data)
        self.received_bytes += len(data)
        self.emulator.receive(data)

    def run(self, ms: float) -> list[tuple[int, bytes]]:
        self.emulator.advance(self.now_ns + round(ms * NS_PER_MS))
        sent, self._sent = self._sent, []
        for t_ns, data in sent:
            self._show(t_ns, "unit", data)
        return sent

    def true_quaternion(self, t_ns: int) -> tuple[float, float, float, float]:
        assert self.emulator.scene is not None
        x, y, z, w = self.emulator.scene.trajectory.q_icrs_to_sensor(t_ns)
        return float(x), float(y), float(z), float(w)

    def say(self, text: str) -> None:
        self._console.print(f"{self.now_ns / NS_PER_S:9.3f} s  [bold]{escape(text)}[/]", soft_wrap=True)

    def check(
        self, name: str, value: float, relation: Literal["<=", ">=", "=="], target: float, unit: str
    ) -> None:
        self.checks.append(check(name, value, relation, target, unit))

    def _show(self, t_ns: int, who: str, data: bytes) -> None:
        for text in self._texts(data):
            self._console.print(f"[dim]{t_ns / NS_PER_S:9.3f} s  {who}  {text}[/]", soft_wrap=True)

    def _texts(self, data: bytes) -> list[str]:
        if self._can:
            return [
                f"{frame.identifier:03X}  [{len(frame.data)}]  {frame.data.hex(' ')}".replace("[", r"\[")
                for frame in RecordDecoder().receive(data)
            ]
        shown = data[:MOST_SHOWN_BYTES].hex(" ")
        more = len(data) - MOST_SHOWN_BYTES
        return [shown + (f" ... {more} more" if more > 0 else "")]


def run_dialect_demo(
    unit: str, dialect: str, seed: int | None, json_path: str | None, console: Console
) -> int:
    """Run a dialect's scripted exchange; exit status 0 when every check holds, else 1.

    Raises:
        ConfigurationError: no such dialect, or it has no exchange.
    """
    require_json_path(json_path)
    profile = with_dialect(load_unit(unit), dialect)
    definition = dialect_of(profile)
    if definition.exchange is None:
        raise ConfigurationError(
            f"--dialect {dialect}: has no scripted exchange; see `st-emulator demo --help`"
        )
    console.print(f"[bold]{escape(profile.unit.title)}[/] speaks {escape(definition.title)}")
    session = Session(profile, definition.on_serial is None, 1 if seed is None else seed, console)
    definition.exchange(session)
    figures = {
        "unit": profile.name,
        "dialect": definition.name,
        "virtual_seconds": session.now_ns / NS_PER_S,
        "octets_to_the_unit": session.received_bytes,
        "octets_from_the_unit": session.sent_bytes,
    }
    show_figures(console, f"demo of {definition.name}", figures)
    show_checks(console, session.checks)
    write_json(json_path, figures, session.checks)
    return 0 if session.checks and all_hold(session.checks) else 1
