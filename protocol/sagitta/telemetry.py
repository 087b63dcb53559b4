"""Telemetry and actions of the language: numbers and data. One table for codec and document."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from .layout import Field, Kind, Layout, Repeated

__all__ = [
    "ACTIONS",
    "ACTIONS_BY_NAME",
    "ACTION_TABLE",
    "TELEMETRY",
    "TELEMETRY_BY_NAME",
    "TELEMETRY_TABLE",
    "ActionDefinition",
    "ActionId",
    "Strategy",
    "TelemetryDefinition",
    "TelemetryId",
    "TrackerMode",
]

_U8, _U16, _U32, _U64, _F32 = Kind.U8, Kind.U16, Kind.U32, Kind.U64, Kind.F32


class TelemetryId(IntEnum):
    """Numbers of telemetry."""

    TIME = 1
    POWER = 11
    SOLUTION = 24
    TEMPERATURE = 27
    HISTOGRAM = 28
    BLOBS = 36
    CENTROIDS = 37
    AUTO_BLOB = 39
    MATCHED = 40
    BLOB_STATISTICS = 49


class ActionId(IntEnum):
    """Numbers of actions."""

    BOOT = 1
    SET_TIME = 14


class TrackerMode(IntEnum):
    """How a solution was looked for."""

    TRACKING = 0
    LISA = 1


class Strategy(IntEnum):
    """The way to a solution."""

    LISA_ONLY = 0
    TRACKING_ONLY = 1
    LISA_THEN_TRACKING = 3
    LISA_OK = 4
    TRACKING_OK = 5
    TRACKING_RECOVERED = 6
    DEMOTED_TO_LISA = 7
    LISA_LOW_CONFIDENCE = 8


STRATEGY_MEANINGS: Final[dict[Strategy, str]] = {
    Strategy.LISA_ONLY: "LISA alone, by configuration; never sent here",
    Strategy.TRACKING_ONLY: "tracking alone, by configuration; never sent here",
    Strategy.LISA_THEN_TRACKING: "LISA, then tracking, by configuration; never sent here",
    Strategy.LISA_OK: "by itself: LISA found the attitude",
    Strategy.TRACKING_OK: "by itself: tracking found the attitude",
    Strategy.TRACKING_RECOVERED: "by itself: tracking went on over a frame without attitude. ASSUMED: that "
    "frame and the first good one after it",
    Strategy.DEMOTED_TO_LISA: "by itself: tracking was given up with this frame",
    Strategy.LISA_LOW_CONFIDENCE: "by itself: LISA did not find the attitude, or no frame was looked at",
}


@dataclass(frozen=True)
class TelemetryDefinition:
    """One kind of telemetry. ``meaning``: what its numbers are here, and what of it is ASSUMED.

    ``of_frame``: it tells of the last frame; else of the instant.
    """

    id: TelemetryId
    data: Layout
    of_frame: bool
    meaning: str

    @property
    def name(self) -> str:
        """Its name in scenarios and documents."""
        return self.id.name.lower()


@dataclass(frozen=True)
class ActionDefinition:
    """One action."""

    id: ActionId
    arguments: Layout
    meaning: str

    @property
    def name(self) -> str:
        """Its name in scenarios and documents."""
        return self.id.name.lower()


def _quaternion(prefix: str, meaning: str) -> tuple[Field, ...]:
    return (
        Field(f"{prefix}w", _F32, f"{meaning}, scalar part"),
        *(Field(f"{prefix}{axis}", _F32) for axis in "xyz"),
    )


RAILS: Final = ("mcu", "fpga_core", "1v8", "2v5", "cmv_2v1", "cmv_pixel", "3v3", "reserve")
SECTIONS: Final = "abcd"
HISTOGRAM_BINS: Final = 9
BLOBS: Final = 8
CENTROIDS: Final = 16

TELEMETRY_TABLE: Final[tuple[TelemetryDefinition, ...]] = (
    TelemetryDefinition(
        TelemetryId.TIME,
        Layout((Field("uptime_ms", _U32, "since the start", "ms"), Field("unix_us", _U64, "now", "us"))),
        False,
        "Known from one simulator alone; the known driver takes it for an error.",
    ),
    TelemetryDefinition(
        TelemetryId.POWER,
        Layout(
            tuple(
                Field(f"{rail}_{what}", _F32, "", unit)
                for rail in RAILS
                for what, unit in (("current", "A"), ("voltage", "V"))
            )
        ),
        False,
        "ASSUMED: nominal voltages and no currents; the device has no power supply that could be measured.",
    ),
    TelemetryDefinition(
        TelemetryId.SOLUTION,
        Layout(
            (
                *_quaternion("", "attitude, inertial to sensor"),
                Field("track_confidence", _F32, "share of the windows' stars that were matched"),
                *_quaternion("track_", "last attitude by tracking"),
                Field("removed", _U8, "clusters that became no spots"),
                Field("centroided", _U8, "spots"),
                Field("matched", _U8, "matched stars"),
                *_quaternion("lisa_", "last attitude by LISA"),
                Field("lisa_fraction_close", _F32, "share of the spots that were matched, 0 to 1"),
                Field("lisa_close", _U8, "stars matched by LISA"),
                Field("mode", _U8, "0 tracking, 1 LISA"),
                Field("valid", _U8, "1: trustworthy"),
                Field("stable_count", _U32, "solutions in a row"),
                Field("strategy", _U8, "see below"),
            )
        ),
        True,
        "ASSUMED: what the confidence is a measure of, the scale of the fraction, and that both are those of "
        "the last frame that was looked at that way. A quaternion is 0,0,0,0 before the first of its kind.",
    ),
    TelemetryDefinition(
        TelemetryId.TEMPERATURE,
        Layout(tuple(Field(f"{part}_degc", _F32, "", "degC") for part in ("mcu", "cmos", "fpga"))),
        False,
        "ASSUMED: all three are the device's one temperature.",
    ),
    TelemetryDefinition(
        TelemetryId.HISTOGRAM,
        Layout(
            tuple(
                Field(f"section_{section}", _U32, "pixels in each bin", "px", count=HISTOGRAM_BINS)
                for section in SECTIONS
            )
        ),
        True,
        "Of the newest image: the last processed frame or the one kept by image processor mode 1. ASSUMED: "
        "the sections are the quarters upper left, upper right, lower left, lower right (odd rows and "
        "columns go right and down), and the bins nine equal parts of the converter's range.",
    ),
    TelemetryDefinition(
        TelemetryId.BLOBS,
        Layout(
            (
                Field("count", _U16, "clusters over the threshold"),
                Field("used", _U16, "those that became spots"),
                Field("four_lines_skipped", _U16, "1: the scan stopped before the end of the image"),
                Repeated("blobs", BLOBS, (Field("x", _U16, "", "px"), Field("y", _U16, "", "px"))),
            )
        ),
        True,
        "The brightest spots to the nearest pixel, column and row from the upper left; 0,0 where there are "
        "fewer. In tracking those of the windows.",
    ),
    TelemetryDefinition(
        TelemetryId.CENTROIDS,
        Layout(
            (
                Field("count", _U16, "spots, those that find no room here included"),
                Repeated(
                    "centroids",
                    CENTROIDS,
                    (
                        Field("x", _F32, "", "px"),
                        Field("y", _F32, "", "px"),
                        Field("magnitude", _U8, "instrumental", "0.1 mag"),
                    ),
                ),
            )
        ),
        True,
        "The brightest spots. ASSUMED: pixels, column and row from the centre of the upper left one, and "
        "tenths of a magnitude, 0 where brighter than 0.",
    ),
    TelemetryDefinition(
        TelemetryId.AUTO_BLOB,
        Layout((Field("threshold", _F32, "over the background", "DN"),)),
        True,
        "The detection threshold of the last frame, which the device takes from the noise.",
    ),
    TelemetryDefinition(
        TelemetryId.MATCHED,
        Layout(
            (
                Field("count", _U8, "matched stars, those that find no room here included"),
                Repeated(
                    "stars",
                    CENTROIDS,
                    (
                        Field("star_id", _U32, "Hipparcos number"),
                        Field("x", _F32, "measured", "px"),
                        Field("y", _F32, "measured", "px"),
                        Field("x_error", _F32, "measured less expected", "px"),
                        Field("y_error", _F32, "measured less expected", "px"),
                    ),
                ),
            )
        ),
        True,
        "The brightest matched stars of the last frame. ASSUMED: the numbers of the catalogue, and pixels.",
    ),
    TelemetryDefinition(
        TelemetryId.BLOB_STATISTICS,
        Layout(
            (
                Field("count", _U8, "matched stars"),
                Repeated(
                    "blobs",
                    CENTROIDS,
                    (
                        Field("noise", _U8, "of the background", "DN"),
                        Field("threshold", _U8, "over the background", "DN"),
                        Field("valid", _U8, "1: a matched star"),
                        Field("overflow", _U8, "1: saturated"),
                    ),
                ),
            )
        ),
        True,
        "Of the brightest spots, 255 where a number is larger. ASSUMED: what valid and overflow say.",
    ),
)

ACTION_TABLE: Final[tuple[ActionDefinition, ...]] = (
    ActionDefinition(
        ActionId.BOOT,
        Layout((Field("region", _U8, "of the program; ASSUMED: each holds the same", default=1),)),
        "Start the program. In the program ASSUMED: answered with OK, and nothing happens (in the device's "
        "FAULT it starts anew).",
    ),
    ActionDefinition(
        ActionId.SET_TIME,
        Layout((Field("unix_us", _U64, "Unix time when the request's last bit arrives", "us"),)),
        "In force from the start of the next frame on. Out of range from 2**32 s after 1958 on, where the "
        "device's clock turns over.",
    ),
)

TELEMETRY: Final[dict[int, TelemetryDefinition]] = {int(entry.id): entry for entry in TELEMETRY_TABLE}
TELEMETRY_BY_NAME: Final[dict[str, TelemetryDefinition]] = {entry.name: entry for entry in TELEMETRY_TABLE}
ACTIONS: Final[dict[int, ActionDefinition]] = {int(entry.id): entry for entry in ACTION_TABLE}
ACTIONS_BY_NAME: Final[dict[str, ActionDefinition]] = {entry.name: entry for entry in ACTION_TABLE}
