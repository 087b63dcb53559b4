"""Why an attitude is not valid. Several reasons can hold at once; the numbers are those of the telemetry."""

from __future__ import annotations

from enum import IntFlag

__all__ = ["REASON_MEANINGS", "Reason"]


class Reason(IntFlag):
    """Reasons of an invalid attitude; no bit set: the attitude is valid."""

    NONE = 0
    TOO_FEW_STARS = 1
    NO_MATCH = 2
    BLINDED = 4
    RATE_TOO_HIGH = 8
    OVERRUN = 16
    NOT_ACQUIRING = 32
    FRAME_DROPPED = 64
    PIVOT_LOST = 128
    RESIDUAL_TOO_LARGE = 256
    AMBIGUOUS = 512
    WORK_LIMIT = 1024
    NO_FRAME = 2048
    TOO_MANY_SPOTS = 4096
    UNCONFIRMED = 8192


REASON_MEANINGS: dict[Reason, str] = {
    Reason.TOO_FEW_STARS: "fewer spots than an attitude needs, or fewer of them verified",
    Reason.NO_MATCH: "enough spots, but no pattern of the catalogue fits them",
    Reason.BLINDED: "background above the limit: Sun, Moon or Earth in or near the field",
    Reason.RATE_TOO_HIGH: "the attitude turns faster than the tracking rate, or spots left their windows",
    Reason.OVERRUN: "processing took longer than the frame",
    Reason.NOT_ACQUIRING: "the mode does not ask for an attitude",
    Reason.FRAME_DROPPED: "the frame was not processed",
    Reason.PIVOT_LOST: "no found star works as pivot: the angles to the others do not fit the catalogue",
    Reason.RESIDUAL_TOO_LARGE: "the stars do not fit one attitude",
    Reason.AMBIGUOUS: "two different attitudes fit the spots",
    Reason.WORK_LIMIT: "identification gave up at its limit of work",
    Reason.NO_FRAME: "the sensor gave no image",
    Reason.TOO_MANY_SPOTS: "the image gave more spots or runs than the tables hold",
    Reason.UNCONFIRMED: "stars are identified, but too few to be sure of them",
}
