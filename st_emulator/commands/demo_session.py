"""What the OBC of a demo did and saw."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..obc import Attitude


@dataclass
class Session:
    """What the OBC did and saw."""

    sent: int = 0
    verified: int = 0
    acquire_ns: int = 0
    packets: int = 0
    crc_errors: int = 0
    malformed: int = 0
    gaps: int = 0
    attitudes: list[Attitude] = field(default_factory=list)
    problem: str = ""
