"""What tests of the OBC's CAN transport look at: frames that leave, events, counters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hil_tests.obc.can_unit import frames_of
from st_emulator.obc import CanTransport
from st_emulator.obc.transport import CanFrameSeen


def drain(transport: CanTransport, now_ns: int = 0, most: int = 10_000) -> list[tuple[int, bytes]]:
    """Every frame that leaves now over a link that takes all."""
    found = []
    while len(found) < most and (line := transport.outgoing(now_ns)):
        found += frames_of(line)
        transport.written(len(line), now_ns)
    return found


def hexes(frames: Iterable[tuple[int, bytes]]) -> list[str]:
    return [f"{identifier:X}#{data.hex().upper()}" for identifier, data in frames]


def told(events: Iterable[Any]) -> list[Any]:
    """Events but for the mere sight of frames."""
    return [event for event in events if not isinstance(event, CanFrameSeen)]


def counted(transport: CanTransport) -> dict[str, int]:
    left_out = ("received_bytes", "sent_bytes", "frames_received", "frames_sent")
    return {name: n for name, n in transport.counters.as_dict().items() if n and name not in left_out}
