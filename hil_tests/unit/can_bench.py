"""A CAN bus whose link and receiver write down what they see."""

from __future__ import annotations

from collections.abc import Callable

from st_emulator.clock import VirtualClock
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.pus.enumerations import CanState
from st_emulator.wire.can.bus import CanBus, CanBusSettings, Disturbance

Log = list[tuple[int, str, CanFrame]]


class CanBench:
    """``log`` has (time, what, frame): "sent" and "refused" by the link, "received" from others, "told" the
    sender. The link refuses the next ``refusals`` frames.
    """

    def __init__(
        self,
        *,
        bitrate: int = 1_000_000,
        data_bitrate: int = 4_000_000,
        hardware: bool = False,
        bus_off_restart_ms: int = 100,
        disturbance: Disturbance | None = None,
    ) -> None:
        self.clock = VirtualClock()
        self.log: Log = []
        self.states: list[tuple[int, CanState, CanState]] = []
        self.refusals = 0
        self.bus = CanBus(
            self.clock,
            CanBusSettings(bitrate, data_bitrate, hardware, bus_off_restart_ms),
            self._transmit,
            lambda frame: self._note("received", frame),
            on_state=lambda before, after: self.states.append((self.clock.now_ns, before, after)),
            disturbance=disturbance,
        )

    def _note(self, kind: str, frame: CanFrame) -> None:
        self.log.append((self.clock.now_ns, kind, frame))

    def _transmit(self, frame: CanFrame) -> bool:
        if self.refusals:
            self.refusals -= 1
            self._note("refused", frame)
            return False
        self._note("sent", frame)
        return True

    def send(self, frame: CanFrame) -> int:
        return self.bus.send(frame, lambda: self._note("told", frame))

    def at(self, at_ns: int, action: Callable[[], object]) -> None:
        self.clock.at(at_ns, lambda: action() and None)

    def advance(self, until_ns: int) -> None:
        self.clock.advance(until_ns)

    def seen(self, *kinds: str) -> Log:
        return [entry for entry in self.log if entry[1] in kinds]
