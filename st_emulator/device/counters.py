"""Counters of the frames."""

from __future__ import annotations

from dataclasses import dataclass, fields


def saturated(count: int, bits: int) -> int:
    """``count`` as telemetry shows it in so many bits: a counter that is full stays at its highest value."""
    return min(count, (1 << bits) - 1)


@dataclass
class FrameCounters:
    """Counters in the housekeeping structure STATUS."""

    frames_processed: int = 0
    frames_valid: int = 0
    frames_tracking: int = 0
    frames_late: int = 0
    frames_dropped: int = 0
    worst_cycles: int = 0

    def clear(self) -> None:
        for item in fields(self):
            setattr(self, item.name, 0)
