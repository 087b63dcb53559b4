"""Counters of the command link and of the frames: what went wrong is counted, each kind for itself."""

from __future__ import annotations

from dataclasses import dataclass, fields


def saturated(count: int, bits: int) -> int:
    """``count`` as telemetry shows it in so many bits: a counter that is full stays at its highest value."""
    return min(count, (1 << bits) - 1)


@dataclass
class LinkCounters:
    """Counters in the housekeeping structure LINK, from power-on or the last CLEAR_COUNTERS."""

    tc_received: int = 0
    tc_accepted: int = 0
    tc_rejected: int = 0
    crc_errors: int = 0
    framing_errors: int = 0
    length_errors: int = 0
    oversized_frames: int = 0
    unknown_apid: int = 0
    unknown_service: int = 0
    sequence_gaps: int = 0
    not_allowed_in_mode: int = 0
    bad_parameters: int = 0
    rx_bytes: int = 0

    def clear(self) -> None:
        for item in fields(self):
            setattr(self, item.name, 0)


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
