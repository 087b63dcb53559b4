"""What is true of one frame."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class TrueStar:
    """A star whose middle of light falls into the image: hip number, where, Hp, electrons.

    x_px, y_px: the mean of its light over the exposure, as the pixels see it: with a rolling shutter those of
    the rows that it passes, while they are exposed. electrons: that it gives in that time. x_mid_px,
    y_mid_px: where it stands at the frame's mid-exposure, whatever the shutter; that is where the frame's
    attitude puts it.
    """

    hip: int
    x_px: float
    y_px: float
    hp_mag: float
    electrons: float
    x_mid_px: float
    y_mid_px: float


@dataclass(frozen=True)
class TruthRecord:
    """What is true of one frame; it goes to the journal of truth, never to the firmware.

    Times in virtual ns; q_icrs_to_sensor [x, y, z, w] and rate_rad_s (sensor axes, relative to ICRS) at
    mid-exposure; ra_deg, dec_deg, roll_deg the same attitude; sub_steps of the exposure's path; bodies: of
    the Sun, Moon and Earth in the sky angle_deg (boresight to centre; Earth: to limb) and stray_electrons_s
    at the boresight; position_km, velocity_km_s: geocentric, or None; stars: brightest first; false_spots
    (x_px, y_px, magnitude).

    The rate that a unit reports is the mean since the frame before: the turn between the two
    q_icrs_to_sensor over the time between their exposure_mid_ns.
    """

    frame_index: int
    exposure_start_ns: int
    exposure_mid_ns: int
    exposure_end_ns: int
    tai_ns: int
    q_icrs_to_sensor: tuple[float, float, float, float]
    rate_rad_s: tuple[float, float, float]
    ra_deg: float
    dec_deg: float
    roll_deg: float
    sub_steps: int
    bodies: dict[str, dict[str, float]]
    position_km: tuple[float, float, float] | None
    velocity_km_s: tuple[float, float, float] | None
    stars: tuple[TrueStar, ...]
    false_spots: tuple[tuple[float, float, float], ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and dictionaries, fit for JSON."""
        return dataclasses.asdict(self)

    def to_json(self) -> str:
        """One line of JSON; every number survives the way there and back."""
        return json.dumps(self.as_dict(), separators=(",", ":"))
