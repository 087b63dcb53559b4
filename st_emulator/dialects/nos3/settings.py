"""What may stand in a unit file's table ``[dialects.nos3]``: how the real unit is, and its quirks by name."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ...units.validation import Section, Switch


class Nos3Settings(Section):
    layout: Annotated[
        Literal["code", "readme"],
        Field(
            description="numbers of the commands and layouts of the replies: `code`, as driver and simulator "
            "have them, or `readme`, as the README of the same repository says"
        ),
    ] = "code"
    enabled: Annotated[
        Switch,
        Field(
            description="false: the unit is disabled, takes nothing and says nothing, and its counter is 0 "
            "(the simulator is told ENABLE and DISABLE beside the wire)"
        ),
    ] = True
    autonomous: Annotated[
        Switch,
        Field(
            description="after boot the unit looks for its attitude by itself; the wire has no command for "
            "it, so that with false every attitude is invalid (unless parameter `autonomous_start` is set)"
        ),
    ] = True
    reply_delay_us: Annotated[
        int,
        Field(
            ge=0,
            le=1_000_000,
            description="time between the last bit of the echo and the first bit of the reply; the driver "
            "waits 50 ms for the whole reply. ASSUMED: 0, as the reference simulator writes both at once",
        ),
    ] = 0
    counter: Annotated[
        Literal["twice", "once"],
        Field(
            description="quirk. `twice`: the command counter grows by 1 for the format and by 1 for the echo "
            "of a command, as in the simulator, so that an unknown command counts 1; `once`: by 1 for each "
            "well-formed command, as the README says"
        ),
    ] = "twice"
    echo: Annotated[
        Literal["accepted", "every"],
        Field(
            description="quirk. `accepted`: an unknown command is not echoed, as in the simulator; `every`: "
            "each well-formed command is, as the README says"
        ),
    ] = "accepted"
    config_command: Annotated[
        Literal["unknown", "echoed"],
        Field(
            description="quirk of layout `code`. `unknown`: command 3, which the driver defines and never "
            "sends, is unknown to the unit, as in the simulator; `echoed`: it is known and echoed. In layout "
            "`readme` the command is always known"
        ),
    ] = "unknown"
    reception: Annotated[
        Literal["line", "callback"],
        Field(
            description="quirk. `line`: octets come in any pieces, a command is found among them, as on a "
            "real line; `callback`: what the other side writes at once must be one command and nothing else, "
            "as the simulator wants it"
        ),
    ] = "line"
    quaternion: Annotated[
        Literal["inertial_to_tracker", "tracker_to_inertial"],
        Field(
            description="which rotation q0 to q3 are; the other one has the vector part's sign changed. "
            "ASSUMED: what the reference sends, 42's qn, is called inertial to tracker, and the sign "
            "convention of its vector part is not documented"
        ),
    ] = "inertial_to_tracker"
