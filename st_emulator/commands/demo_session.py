"""What the OBC of a demo did and saw, and what any demo says of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ..obc import Attitude
from ..report import Check, check

LOST_IN_SPACE_TARGET_S = 2.0
START_UTC = "2026-01-15T00:00:00Z"


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

    def acquired_s(self, reports: Sequence[Attitude]) -> float | None:
        """Seconds from the command to the first valid attitude; None without one."""
        first = next((report for report in reports if report.valid), None)
        return None if first is None else (first.received_ns - self.acquire_ns) * 1e-9

    def figures(self) -> dict[str, Any]:
        """Of the exchange."""
        return {
            "telemetry_packets": self.packets,
            "crc_errors": self.crc_errors,
            "malformed": self.malformed,
            "sequence_gaps": self.gaps,
            "telecommands_sent": self.sent,
            "telecommands_verified": self.verified,
            "overruns": sum(report.late for report in self.attitudes),
            "problem": self.problem or None,
        }

    def checks(self, acquired_s: float | None) -> list[Check]:
        """Of the exchange, and of the time to the first attitude."""
        return [
            check("crc_errors", self.crc_errors, "==", 0, "packets"),
            check("sequence_gaps", self.gaps, "==", 0, "gaps"),
            check("telecommands_verified", self.verified, "==", self.sent, "telecommands"),
            check("lost_in_space_s", acquired_s, "<=", LOST_IN_SPACE_TARGET_S, "s"),
        ]


def scenario_head(unit: str, doing: str, seconds: float, seed: int, roll_deg: float) -> str:
    """The beginning of a demo's scenario, TOML text: it starts at the belt of Orion."""
    return f"""# The demo of {unit}: at rest, {doing}, at rest.
schema = 1
name = "demo"
duration_s = {seconds:g}
start_utc = "{START_UTC}"
seed = {seed}

[trajectory]
kind = "slew"
ra_deg = 84.0
dec_deg = -1.5
roll_deg = {roll_deg}
"""
