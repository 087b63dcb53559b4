"""What may stand in ``[dialects.sagitta]`` of a unit file; each quirk of the real unit has its switch."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ...protocol.sagitta.frames import ADDRESS
from ...protocol.sagitta.parameters import SUBSCRIPTION_SLOTS
from ...units.validation import Section, Switch

RateHz = Annotated[float, Field(ge=0.01, le=50)]


class SagittaSettings(Section):
    """Defaults are as the real unit does it, as far as that is known."""

    address: Annotated[
        int,
        Field(
            ge=0,
            le=255,
            description=("address of the unit, first byte of every frame"),
        ),
    ] = ADDRESS
    boot_loader: Annotated[
        Switch,
        Field(
            description=(
                "after power the boot loader runs, which waits for the action boot; false: the "
                "program starts by itself"
            ),
        ),
    ] = True
    boot_loader_answers: Annotated[
        Switch,
        Field(
            description=(
                "the boot loader answers what it does not take with status 4. ASSUMED false: the "
                "one simulator that is known says nothing before the boot"
            ),
        ),
    ] = False
    autonomous: Annotated[
        Switch,
        Field(
            description=(
                "the program looks for the attitude by itself as soon as it runs. ASSUMED: no "
                "action of the language asks for it"
            ),
        ),
    ] = True
    boresight: Annotated[
        Literal["+x", "+z"],
        Field(
            description=("axis of the boresight in the frame of the quaternions"),
        ),
    ] = "+x"
    set_time_words: Annotated[
        Literal["low_first", "high_first"],
        Field(
            description=(
                "order of the two words of 32 bits of set time. low_first is one number of 64 "
                "bits; the driver names its first word the upper one and sends it first, for "
                "which an OBC may want high_first"
            ),
        ),
    ] = "low_first"
    parameter_status: Annotated[
        Switch,
        Field(
            description=(
                "a reply 81 has a status in front of its arguments, like all other replies. The "
                "real unit's has none"
            ),
        ),
    ] = False
    hash_checked: Annotated[
        Switch,
        Field(
            description=(
                "a request whose hash does not fit is thrown away; ASSUMED true (the known "
                "simulator does not look at it)"
            ),
        ),
    ] = True
    hold_quaternion: Annotated[
        Switch,
        Field(
            description=("without attitude the last one is sent on, valid 0; false: 0,0,0,0"),
        ),
    ] = True
    validation: Annotated[
        Switch,
        Field(
            description=("valid needs what parameter validation asks for; false: each solved frame is valid"),
        ),
    ] = True
    solution_time: Annotated[
        Literal["sending", "mid_exposure"],
        Field(
            description=(
                "what the time in front of a solution is. ASSUMED sending: so does the simulator,"
                " and the driver's time must not step back between two frames"
            ),
        ),
    ] = "sending"
    solution_rate_hz: Annotated[
        RateHz,
        Field(
            description=(
                "largest rate of subscribed solutions: each n-th frame. ASSUMED, from the simulator"
            ),
        ),
    ] = 5.0
    temperature_rate_hz: Annotated[
        RateHz,
        Field(
            description=("rate of subscribed temperatures. ASSUMED, from the simulator"),
        ),
    ] = 1.0
    other_rate_hz: Annotated[
        RateHz,
        Field(
            description=("largest rate of each other subscribed telemetry. ASSUMED: once a second"),
        ),
    ] = 1.0
    most_frames_per_s: Annotated[
        int,
        Field(
            ge=1,
            le=1000,
            description=(
                "subscribed telemetry that would make more frames than this in a second, replies "
                "included, is left out. ASSUMED: the driver takes one frame each 100 ms"
            ),
        ),
    ] = 9
    subscription_slots: Annotated[
        int,
        Field(
            ge=1,
            le=SUBSCRIPTION_SLOTS,
            description=("so many slots of the subscription count; the known simulator has 2"),
        ),
    ] = SUBSCRIPTION_SLOTS
