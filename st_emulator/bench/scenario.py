"""Scenarios: a TOML file says how the unit moves, what the sky holds and which telecommands come when.

Everything in a scenario happens at virtual times, so the same scenario gives the same bytes at any speed.
The JSON schema is written by ``st-emulator export scenario-schema``.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from ..faults.catalogue import AnyFault
from ..units.profile import NonNegative, Positive
from ..units.validation import Section, Switch, parse_toml, read_text, validate
from ..world.display import Display
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
    "DisplayedSky",
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


class DisplayedSky(Section):
    """A display behind a collimator shows the sky: the laboratory's way to stand in front of a real sensor.

    Fasano et al., Sensors 13 (2013), section 3 and table 2: a star is one pixel of the display, or the strip
    that it runs over while a scene is shown. Its figures are the defaults. The dark room holds no Sun, Moon
    and Earth.
    """

    columns: Annotated[int, Field(ge=16, le=32768, description="pixels of the display, along image x")] = 2560
    rows: Annotated[int, Field(ge=16, le=32768, description="pixels of the display, along image y")] = 1600
    width_mm: Annotated[
        float,
        Field(ge=1, le=100000, description="of all columns, mm; pixels are square"),
    ] = 641.0
    collimator_mm: Annotated[
        float, Field(ge=1, le=1000000, description="focal length of the collimator, mm")
    ] = 1300.0
    update_hz: Annotated[float, Field(ge=0.1, le=100000, description="scenes a second")] = 60.0
    levels: Annotated[
        int, Field(ge=1, le=2**24, description="steps of a pixel's brightness, linear in light")
    ] = 255
    brightest_mag: Annotated[
        float, Field(ge=-30, le=30, description="magnitude of the highest step; brighter stars show as that")
    ] = 1.0

    @property
    def display(self) -> Display:
        """What the world makes of it."""
        return Display(
            columns=self.columns,
            rows=self.rows,
            pitch_mm=self.width_mm / self.columns,
            focal_mm=self.collimator_mm,
            update_hz=self.update_hz,
            levels=self.levels,
            brightest_mag=self.brightest_mag,
        )


def _displayed(value: Any) -> Any:
    """true: a display like the paper's; false: the sky itself."""
    return {True: {}, False: None}[value] if isinstance(value, bool) else value


class Sky(Section):
    """What the sky holds besides the stars, and whether a display shows it."""

    aberration: Switch = True
    sun: Switch = True
    moon: Switch = True
    earth: Switch = True
    false_spots: Annotated[int, Field(ge=0, le=1000)] = 0
    false_spot_magnitudes: tuple[float, float] = (3.0, 6.0)
    display: Annotated[
        DisplayedSky | None,
        BeforeValidator(_displayed, json_schema_input_type=bool | DisplayedSky | None),
        Field(description="true, or a table: a display behind a collimator shows the sky, without bodies"),
    ] = None


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
