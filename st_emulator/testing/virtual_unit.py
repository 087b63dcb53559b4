"""Units in this process, in virtual time: on lines of their own or together on one CAN bus."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bench.emulator import Emulator
from ..bench.joined import can_transport_of
from ..bench.scenario import Scenario
from ..bench.supervision import Supervision
from ..compiled_kernels import keep_compiled_kernels
from ..links import Link, LinkError, memory_link_pair
from ..obc import Obc, SlipTransport, Transport
from ..wire.can.wiring import CanWiring
from .clock import BenchReader, VirtualBenchClock
from .star_tracker import StarTracker

if TYPE_CHECKING:
    from ..links.memory import MemoryLink
    from ..units.profile import UnitProfile
    from .expectations import Expectations

CAPACITY_BYTES = 1 << 20
"""Of what an OBC that is there does not read; more is lost, as on a wire."""

Take = Callable[[bytes], None]


class Medium:
    """A line or a bus in memory: what one writes all others get, at the same instant."""

    def __init__(self) -> None:
        self._units: list[Take] = []
        self._ends: list[MemoryLink] = []

    def add_unit(self, take: Take) -> None:
        """``take`` is called with what others put on the medium."""
        self._units.append(take)

    def open_end(self) -> Link:
        """The end of an OBC."""
        inside, outside = memory_link_pair(CAPACITY_BYTES)
        self._ends.append(inside)
        return outside

    def put(self, data: bytes, sender: Take | MemoryLink) -> None:
        """Bring ``data`` to all others."""
        for take in self._units:
            if take != sender:
                take(data)
        for end in self._ends:
            if end is not sender:
                end.write(data)

    def carry(self) -> bool:
        """Take what OBCs have written since; whether there was anything."""
        carried = False
        for end in list(self._ends):
            try:
                data = end.read()
            except LinkError:  # the OBC has closed its end
                self._ends.remove(end)
                continue
            if data:
                carried = True
                self.put(data, end)
        return carried


class VirtualStarTracker(StarTracker):
    """A unit in virtual time. It lives from its first power-on: the bench's time then is its virtual time
    zero.
    """

    supervised: Supervision

    def __init__(
        self,
        profile: UnitProfile,
        scenario: Scenario | None,
        clock: VirtualBenchClock,
        bench: Expectations,
        medium: Medium,
        *,
        wiring: CanWiring | None,
        link: str,
        journal: Path | None,
        **arguments: Any,
    ) -> None:
        node = None if wiring is None else (wiring.node or profile.can.node)
        super().__init__(profile, link, node, bench)
        self.journal = journal
        self._scenario = scenario or Scenario()
        self._clock = clock
        self._medium = medium
        self._wiring = wiring
        self._arguments = arguments
        self._incoming = bytearray()
        self._stack = contextlib.ExitStack()
        self._origin_ns = clock.now_ns
        self._emulator: Emulator | None = None
        medium.add_unit(self._arrived)
        clock.join(self)

    @property
    def emulator(self) -> Emulator:
        """The unit itself; before its first power-on there is none."""
        if self._emulator is None:
            raise RuntimeError(f"unit {self.name}: power has not come on yet; power_on() first")
        return self._emulator

    @property
    def mode(self) -> str:
        """The name of its mode; OFF as well before power comes on."""
        return "OFF" if self._emulator is None else self.supervised.mode()

    def power_on(self) -> None:
        """Let power come on; it boots."""
        if self._emulator is not None:
            self.supervised.power(True)
            return
        keep_compiled_kernels()
        journal = None
        if self.journal is not None:
            self.journal.parent.mkdir(parents=True, exist_ok=True)
            journal = self._stack.enter_context(self.journal.open("w", encoding="utf-8", newline="\n"))
        self._origin_ns = self._clock.now_ns
        self._emulator = Emulator(
            self.profile,
            self._scenario,
            can=self._wiring,
            transmit=self._transmitted,
            journal=journal,
            **self._arguments,
        )
        self.supervised = Supervision(self._emulator)

    def power_off(self) -> None:
        """Cut the power: it falls silent at once."""
        if self._emulator is not None:
            self.supervised.power(False)

    def close(self) -> None:
        """Its journal gets its end mark."""
        super().close()
        self._clock.leave(self)
        if self._emulator is not None:
            self._emulator.close()
        self._stack.close()

    # -- in the bench's time

    def take_in(self) -> bool:
        """Take what has come at the present time."""
        carried = self._medium.carry()
        if not self._incoming:
            return carried
        data = bytes(self._incoming)
        self._incoming.clear()
        if self._emulator is not None:
            self._emulator.receive(data)
        return True

    def next_event_ns(self) -> int | None:
        """The emulator's, in the bench's time."""
        event_ns = None if self._emulator is None else self._emulator.next_event_ns()
        return None if event_ns is None else event_ns + self._origin_ns

    def advance(self, until_ns: int) -> None:
        """Let the emulator go on."""
        if self._emulator is not None:
            self._emulator.advance(until_ns - self._origin_ns)

    # -- within

    def _arrived(self, data: bytes) -> None:
        self._incoming += data

    def _transmitted(self, data: bytes, t_ns: int) -> int:
        self._medium.put(data, self._arrived)
        return len(data)  # it left the unit, whether somebody listens or not

    def _make_obc(self) -> Obc:
        transport: Transport
        if self._wiring is None:
            baud = self._arguments.get("baud") or self.profile.wire.baud
            transport = SlipTransport(baud)
        else:
            transport = can_transport_of(self.profile, self._wiring)
        return Obc(
            self._medium.open_end(),
            apid=self.profile.apid,
            source_id=self.profile.wire.source_id,
            reader=BenchReader(self._clock, self._scenario.start_utc, lambda: self._origin_ns),
            transport=transport,
        )

    def _make_line(self) -> Link:
        return self._medium.open_end()
