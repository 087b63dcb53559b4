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
    Reason.TOO_FEW_STARS: "fewer spots or identified stars than the solution needs",
    Reason.NO_MATCH: "enough spots, but no consistent identification",
    Reason.BLINDED: "background above the limit of parameter blinded_background_dn",
    Reason.RATE_TOO_HIGH: "angular rate above what the detection windows cover",
    Reason.OVERRUN: "a frame needed more cycles than its budget and this one was dropped for it",
    Reason.NOT_ACQUIRING: "the mode does not process frames",
    Reason.FRAME_DROPPED: "the frame was dropped before processing",
    Reason.PIVOT_LOST: "no star could serve as pivot for the verification of the windows",
    Reason.RESIDUAL_TOO_LARGE: "residual of the attitude solution above the tolerance",
    Reason.AMBIGUOUS: "more than one consistent identification",
    Reason.WORK_LIMIT: "the search was cut off at its work limit",
    Reason.NO_FRAME: "the sensor delivered no frame",
    Reason.TOO_MANY_SPOTS: "more spots than the unit handles",
    Reason.UNCONFIRMED: "stars were identified, but too few of them to be sure",
}
