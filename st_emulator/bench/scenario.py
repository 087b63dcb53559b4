"""Scenarios: a TOML file says how the unit moves, what the sky holds and which telecommands come when.

Everything in a scenario happens at virtual times, so the same scenario gives the same bytes at any speed.
The JSON schema is written by ``st-emulator export scenario-schema``.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from ..faults.catalogue import AnyFault
from ..units.profile import NonNegative, Positive
from ..units.validation import Section, Switch, parse_toml, read_text, validate
from .trajectory_sections import (
    ConstantRateTrajectory,
    DetumbleTrajectory,
    EarthFixedTrajectory,
    FileTrajectory,
    HoldSegment,
    InertialTrajectory,
    NadirTrajectory,
    OrbitTrajectory,
    Pointing,
    RateSegment,
    SlewSegment,
    SlewTrajectory,
    SunTrajectory,
    TargetTrajectory,
    Trajectory,
)

__all__ = [
    "ConstantRateTrajectory",
    "DetumbleTrajectory",
    "EarthFixedTrajectory",
    "FileTrajectory",
    "HoldSegment",
    "InertialTrajectory",
    "NadirTrajectory",
    "OrbitTrajectory",
    "Pointing",
    "RateSegment",
    "Scenario",
    "ScenarioTelecommand",
    "Sky",
    "SlewSegment",
    "SlewTrajectory",
    "SunTrajectory",
    "TargetTrajectory",
    "Trajectory",
    "load_scenario",
    "parse_scenario",
]

# UTC has whole leap seconds from 1972 on; the on-board time, four octets of seconds since 1958, ends in 2094.
FIRST_START = datetime(1972, 1, 1, tzinfo=UTC)
END_OF_STARTS = datetime(2090, 1, 1, tzinfo=UTC)
DEFAULT_START = datetime(2026, 1, 15, tzinfo=UTC)


class Sky(Section):
    """What the sky holds besides the stars."""

    aberration: Switch = True
    sun: Switch = True
    moon: Switch = True
    earth: Switch = True
    false_spots: Annotated[int, Field(ge=0, le=1000)] = 0
    false_spot_magnitudes: tuple[float, float] = (3.0, 6.0)


class ScenarioTelecommand(Section):
    """A telecommand that arrives on the line at a virtual time: by name and fields, or as raw bytes of
    the line.
    """

    at_s: NonNegative
    name: str | None = None
    fields: dict[str, Any] = Field(default_factory=dict)
    raw_hex: str | None = None

    @model_validator(mode="after")
    def _one_of(self) -> ScenarioTelecommand:
        if (self.name is None) == (self.raw_hex is None):
            raise ValueError("give either name (with fields) or raw_hex")
        if self.raw_hex is not None:
            try:
                bytes.fromhex(self.raw_hex)
            except ValueError:
                raise ValueError("raw_hex must be pairs of hexadecimal digits") from None
        return self


class Scenario(Section):
    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    name: str = "unnamed"
    description: str = ""
    duration_s: Positive | None = None
    start_utc: datetime = DEFAULT_START
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1
    trajectory: Trajectory = InertialTrajectory(ra_deg=83.0, dec_deg=-3.0, roll_deg=0.0)
    sky: Sky = Sky()
    parameters: dict[str, float | int] = Field(default_factory=dict)
    telecommands: list[ScenarioTelecommand] = Field(default_factory=list)
    faults: list[AnyFault] = Field(default_factory=list)

    @model_validator(mode="after")
    def _start_fits(self) -> Scenario:
        if self.start_utc.tzinfo is None:
            raise ValueError("start_utc must carry its time zone, for instance 2026-01-15T00:00:00Z")
        if not FIRST_START <= self.start_utc < END_OF_STARTS:
            raise ValueError(
                f"start_utc = {self.start_utc.isoformat()} is out of range; allowed are dates from "
                f"{FIRST_START:%Y-%m-%d} to before {END_OF_STARTS:%Y-%m-%d}"
            )
        return self

    @property
    def where(self) -> str:
        """What errors call this scenario: its file, else its name."""
        return self.origin or f"scenario {self.name}"


def load_scenario(path: str | Path) -> Scenario:
    """Load and validate a scenario file.

    Raises:
        ConfigurationError: names the file, the key and what is allowed.
    """
    path = Path(path)
    return parse_scenario(read_text(path, "a scenario"), str(path))


def parse_scenario(text: str, where: str) -> Scenario:
    """Validate the TOML text of a scenario; ``where`` names it in errors."""
    return validate(Scenario, parse_toml(text, where), where)
