"""What may stand in the table ``[dialects.canopen]`` of a unit file.

Quirks of the real card are on by default, as it has them.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ...protocol.canopen.card import DEFAULT_NODE, OBC_NODE
from ...units.validation import Section, Switch

Node = Annotated[int, Field(ge=1, le=127)]


class CanopenSettings(Section):
    """Settings of the dialect canopen."""

    node: Node = Field(DEFAULT_NODE, description="number of the card; --node goes before it")
    obc_node: Node = Field(OBC_NODE, description="RPDO 1 is TPDO 1 of this node: identifier 180h + it")
    heartbeat_ms: Annotated[int, Field(ge=0, le=65_535)] = Field(1000, description="default of 1017h")
    goes_operational: Switch = Field(
        True, description="the card goes operational by itself behind its boot-up message; else it is told to"
    )
    boot_ms: Annotated[int, Field(ge=0, le=600_000)] = Field(
        0,
        description="how long the card stays in BOOT, from its start on; 0: the unit's own boot time, which "
        "is also the least. The real card: 70000",
    )
    sdo_timeout_ms: Annotated[int, Field(ge=10, le=60_000)] = Field(
        1000, description="a transfer whose client says nothing for so long is aborted"
    )
    ignores_bad_states: Switch = Field(
        True,
        description="quirk: a write of 4000h that asks for a state which cannot follow is acknowledged and "
        "ignored; else it is aborted",
    )
    whole_seconds_since_midnight: Switch = Field(
        True,
        description="quirk: time_since_midnight holds whole seconds of Unix time; else milliseconds since "
        "midnight UTC",
    )
    attitude_known_stays: Switch = Field(
        True, description="quirk: attitude_known stays 1 once an image was solved; else it follows the images"
    )
    fixed_pdo_parameters: Switch = Field(
        True,
        description="quirk: identifiers, transmission types and inhibit times of PDOs are constants, only "
        "the event timers of TPDOs can be written; else all of them",
    )
    boresight: Literal["z", "x"] = Field(
        "z",
        description="axes of the attitude. z: the device's own frame (+Z boresight, x along columns, "
        "y along rows); x: the same turned so that +X is the boresight, +Y against the columns, +Z against "
        "the rows",
    )
    direction: Literal["icrs_to_sensor", "sensor_to_icrs"] = Field(
        "icrs_to_sensor", description="what the quaternion turns the components of a vector from and to"
    )
