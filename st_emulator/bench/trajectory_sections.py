"""How a scenario lets the sensor move: a section a kind."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..units.profile import NonNegative, Positive
from ..units.validation import Section

RightAscension = Annotated[
    float, Field(ge=0, lt=360, description="ICRS right ascension of the boresight, degrees")
]
Declination = Annotated[float, Field(ge=-90, le=90, description="ICRS declination of the boresight, degrees")]
Roll = Annotated[
    float, Field(ge=-360, le=360, description="position angle of image up (-Y), degrees east of north")
]
Vector3 = tuple[float, float, float]


class Pointing(Section):
    ra_deg: RightAscension
    dec_deg: Declination
    roll_deg: Roll = 0.0


class InertialTrajectory(Pointing):
    """At rest to the stars."""

    kind: Literal["inertial"] = "inertial"


class ConstantRateTrajectory(Pointing):
    """A constant angular rate in sensor axes from the pointing at power-on."""

    kind: Literal["constant_rate"]
    rate_deg_s: Annotated[
        Vector3, Field(description="rate of the sensor to ICRS, sensor axes x, y, z, deg/s")
    ]


class EarthFixedTrajectory(Pointing):
    """At rest on the turning Earth; the pointing is that of power-on.

    With a site (geodetic, WGS 84, east positive) the observer also has a place and a velocity.
    """

    kind: Literal["earth_fixed"]
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    longitude_deg: Annotated[float, Field(ge=-180, le=360)] | None = None

    @model_validator(mode="after")
    def _whole_site(self) -> EarthFixedTrajectory:
        if (self.latitude_deg is None) != (self.longitude_deg is None):
            raise ValueError("a site needs both latitude_deg and longitude_deg")
        return self


class HoldSegment(Section):
    kind: Literal["hold"]
    duration_s: Positive


class SlewSegment(Section):
    """A smooth turn by the shortest way to a pointing, at rest at both ends."""

    kind: Literal["slew_to"]
    duration_s: Positive
    ra_deg: RightAscension
    dec_deg: Declination
    roll_deg: Roll = 0.0


class RateSegment(Section):
    """A constant rate in sensor axes, reached and left within ramp_s (0: at once)."""

    kind: Literal["rate"]
    duration_s: Positive
    rate_deg_s: Vector3
    ramp_s: NonNegative = 0.5


Segment = Annotated[HoldSegment | SlewSegment | RateSegment, Field(discriminator="kind")]


class SlewTrajectory(Pointing):
    """Segments one after the other, from the pointing at power-on; after the last the attitude is held."""

    kind: Literal["slew"]
    segments: Annotated[list[Segment], Field(min_length=1)]


class OrbitTrajectory(Section):
    """A circular orbit, the sensor turning with the orbital frame (x along velocity, z to nadir)."""

    kind: Literal["orbit"]
    altitude_km: Annotated[float, Field(ge=150, le=40000)]
    inclination_deg: Annotated[float, Field(ge=0, le=180)]
    raan_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    argument_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    boresight: Annotated[
        Vector3,
        Field(
            description="boresight in the orbital frame: x along velocity, y against the normal, z to nadir"
        ),
    ] = (0.0, 0.0, -1.0)
    roll_deg: Annotated[float, Field(ge=-360, le=360, description="turn about the boresight")] = 0.0


class Orbit(Section):
    """A circular orbit."""

    altitude_km: Annotated[float, Field(ge=150, le=40000)]
    inclination_deg: Annotated[float, Field(ge=0, le=180)]
    raan_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    argument_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0


class PointingOrbit(Orbit):
    """An orbit on which the spacecraft points at something: axis 3 of its frame towards it, axis 2 as near as
    that allows to the direction against the orbit's angular momentum.
    """

    boresight: Annotated[
        Vector3, Field(description="boresight in the spacecraft's frame, whose axis 3 points at the target")
    ] = (0.0, 0.0, 1.0)
    roll_deg: Annotated[float, Field(ge=-360, le=360, description="turn about the boresight")] = 0.0


class NadirTrajectory(PointingOrbit):
    """Axis 3 to the Earth's centre."""

    kind: Literal["nadir"]


class SunTrajectory(PointingOrbit):
    """Axis 3 to the Sun."""

    kind: Literal["sun"]


class TargetTrajectory(PointingOrbit):
    """Axis 3 to a place on the turning Earth (geodetic, WGS 84, east positive; also through the Earth when it
    is behind), to a direction of the sky (ICRS) or to a star by its Hipparcos number: one of them.
    """

    kind: Literal["target"]
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    longitude_deg: Annotated[float, Field(ge=-180, le=360)] | None = None
    height_m: Annotated[float, Field(ge=-1000, le=100_000)] = 0.0
    ra_deg: RightAscension | None = None
    dec_deg: Declination | None = None
    hip: Annotated[int, Field(ge=1, le=120_416, description="Hipparcos number")] | None = None

    @model_validator(mode="after")
    def _one_target(self) -> TargetTrajectory:
        place = (self.latitude_deg is not None, self.longitude_deg is not None)
        sky = (self.ra_deg is not None, self.dec_deg is not None)
        star = self.hip is not None
        if place[0] != place[1] or sky[0] != sky[1] or (place[0] + sky[0] + star) != 1:
            raise ValueError("needs one of: latitude_deg and longitude_deg; ra_deg and dec_deg; hip")
        return self


class DetumbleTrajectory(Pointing):
    """From a pointing at power-on with a rate in sensor axes that falls as exp(-t / time_constant_s)."""

    kind: Literal["detumble"]
    rate_deg_s: Vector3
    time_constant_s: Positive


class FileTrajectory(Section):
    """Attitudes from a file: a CCSDS Attitude Ephemeris Message, or CSV of time and quaternion (columns: see
    docs/trajectories.md). Between them it is interpolated; a run ends with them at the latest.
    """

    kind: Literal["file"]
    path: Annotated[str, Field(min_length=1, description="relative to the scenario file")]
    format: Annotated[
        Literal["aem", "csv"] | None, Field(description="default: what the file looks like")
    ] = None
    quaternion: Annotated[
        Literal["icrs_to_body", "body_to_icrs"],
        Field(description="of CSV: which components it turns into which; an AEM says it itself"),
    ] = "icrs_to_body"
    q_body_to_sensor: Annotated[
        tuple[float, float, float, float],
        Field(description="how the sensor is mounted on the file's body: x, y, z, w, passive"),
    ] = (0.0, 0.0, 0.0, 1.0)
    content: Annotated[
        str | None,
        Field(description="the file's text, as a journal keeps it; the file is not read then"),
    ] = None

    @model_validator(mode="after")
    def _mounting_is_a_turn(self) -> FileTrajectory:
        if not any(self.q_body_to_sensor):
            raise ValueError("q_body_to_sensor has to be four numbers, not all zero")
        return self


Trajectory = Annotated[
    InertialTrajectory
    | ConstantRateTrajectory
    | EarthFixedTrajectory
    | SlewTrajectory
    | OrbitTrajectory
    | NadirTrajectory
    | TargetTrajectory
    | SunTrajectory
    | DetumbleTrajectory
    | FileTrajectory,
    Field(discriminator="kind"),
]
