"""Functions of service 8: one table."""

from __future__ import annotations

from dataclasses import dataclass

from .enumerations import FunctionId, ResetKind
from .field_types import FLOAT64, UINT8, UINT16
from .fields import Field


@dataclass(frozen=True)
class FunctionDefinition:
    """One function: its number, arguments and what its execution means. ``verification``: reports after
    acceptance.
    """

    id: FunctionId
    meaning: str
    fields: tuple[Field, ...] = ()
    verification: str = "completion at once"

    @property
    def name(self) -> str:
        """Its name."""
        return self.id.name


def _quaternion_part(name: str, meaning: str) -> Field:
    # The norm is the unit's to check; the limits leave room for the rounding of a unit quaternion.
    return Field(name, FLOAT64, "", -1.0001, 1.0001, meaning)


FUNCTION_TABLE: tuple[FunctionDefinition, ...] = (
    FunctionDefinition(FunctionId.GO_STANDBY, "go to STANDBY; frames are no longer processed"),
    FunctionDefinition(
        FunctionId.START_ACQUISITION,
        "go to LOST_IN_SPACE and from there, with the first attitude, to TRACKING; by RATE_ONLY where the "
        "unit turns too fast for an attitude",
        verification="start; completion with the first valid attitude",
    ),
    FunctionDefinition(
        FunctionId.START_SELF_TEST,
        "test processor, memories, catalogue and sensor",
        verification="start; progress 1 to 4; completion when all passed, completion failure "
        "SELF_TEST_FAILED otherwise",
    ),
    FunctionDefinition(
        FunctionId.RESET,
        "abort what runs, take no more telecommands, let the queue run empty, restart",
        (Field("kind", UINT8, meaning="what is kept", choices=ResetKind),),
        verification="start; then event BOOT_COMPLETED instead of a completion report",
    ),
    FunctionDefinition(
        FunctionId.CAPTURE_IMAGE,
        "keep the next frame that the sensor delivers, for download (service 13)",
        verification="start; completion when the image is there",
    ),
    FunctionDefinition(
        FunctionId.DOWNLOAD_IMAGE,
        "send the captured image, or some of its parts again, by service 13",
        (
            Field("transaction_id", UINT16, meaning="large message transaction identifier of the parts"),
            Field("first_part", UINT16, meaning="number of the first part to send; 0: from the start"),
            Field("parts", UINT16, meaning="number of parts to send; 0: all that follow"),
        ),
        verification="start; progress 1 to 9 with each tenth of the parts; completion after the last one",
    ),
    FunctionDefinition(FunctionId.ABORT_DOWNLOAD, "stop a running download"),
    FunctionDefinition(
        FunctionId.SHUTDOWN,
        "abort what runs, take no more telecommands, let the queue run empty, go to OFF",
        verification="start; completion before the line goes quiet",
    ),
    FunctionDefinition(FunctionId.CLEAR_COUNTERS, "set the counters of the housekeeping structures to 0"),
    FunctionDefinition(
        FunctionId.RESTORE_DEFAULT_PARAMETERS, "set every parameter to its default and store that"
    ),
    FunctionDefinition(
        FunctionId.TRACK_FROM,
        "go to TRACKING from a given attitude instead of searching the sky",
        (
            _quaternion_part("q_x", "q_icrs_to_sensor, vector part x"),
            _quaternion_part("q_y", "q_icrs_to_sensor, vector part y"),
            _quaternion_part("q_z", "q_icrs_to_sensor, vector part z"),
            _quaternion_part("q_w", "q_icrs_to_sensor, scalar part; the norm shall be 1 within 0.001"),
        ),
        verification="start; completion with the first valid attitude",
    ),
)

FUNCTIONS: dict[int, FunctionDefinition] = {int(function.id): function for function in FUNCTION_TABLE}
"""By number."""
