"""The interface document of the dialect: messages from their tables, settings from their model."""

from __future__ import annotations

from typing import Any

from ...protocol.exporters.markdown import table
from ...protocol.sagitta.document import message_chapters
from ...protocol.sagitta.frames import MessageType, body_of, frame_of
from ...protocol.sagitta.telemetry import ActionId, TelemetryId
from .settings import SagittaSettings

INTRODUCTION = """\
# Dialect `sagitta`

Restated from public source of one mission: the driver of its on-board computer (ut-issl/c2a-aobc) and the
simulated component that it is tested with (ut-issl/s2e-aobc). No document of the vendor was seen. What
neither says, or one says weakly, is marked ASSUMED with the reason. This file is generated from the message
definitions.

A unit speaks it on its serial line (8N1, 115200 baud for the real one) with

```toml
[wire]
dialect = "sagitta"
```

in its file; settings stand in `[dialects.sagitta]`. There is no CAN bus.
"""

BEHAVIOUR = """\
## Life

| State | Device's mode | What the unit does |
|-------|---------------|--------------------|
| off | OFF | nothing |
| power-on, restart | BOOT | nothing for `timing.boot_ms`; what arrives is lost |
| boot loader | STANDBY | takes the action boot alone; takes no images, sends nothing by itself |
| start of the program | BOOT | after the reply to boot has left, as at power-on |
| program, LISA | LOST_IN_SPACE | at once with setting `autonomous`; all requests |
| program, tracking | TRACKING | after the first attitude; all requests |
| program, LISA | RATE_ONLY | valid 0, strategy LISA_LOW_CONFIDENCE; no field has the rate |
| program, at rest | STANDBY | without `autonomous`; all requests; no action leads out |
| program, fault | FAULT | solutions are invalid; mapped parameters are refused (status 3); boot restarts |

Without setting `boot_loader` the program starts at the end of the first BOOT. ASSUMED: in the boot loader
what is not boot is not answered (setting `boot_loader_answers`: status 4, for 81 see below); the program's
start takes as long as the loader's; any restart that the OBC did not ask for ends in the boot loader.

The start of the program is a cold reset: time starts from 0, counters too. ASSUMED: **parameters do not
survive it**, nor a power cycle: they read as their defaults, what was mapped is as before, nothing is
subscribed. The known driver sends every parameter after each boot, the subscription last. (What was mapped
stays in the file of a unit whose emulator ends without a start of the unit: the device keeps its own
parameters.)

## Requests

A request is answered `timing.telecommand_latency_us` after its last bit, in the order of arrival. ASSUMED:
83 is the short form with the status alone; arguments where there should be none are status 2. Where a reply
81 has no status (setting `parameter_status`) a parameter that cannot be read is not answered: a driver that
does not look at the length would take other bytes for arguments. What finds the queue of 4096 bytes full is
lost whole (ASSUMED).

## Counter and time

The counter goes up by one with each 82 and 84 from 0 at the start. ASSUMED: what it counts; the driver does
not look. The time is in Unix microseconds, and the device keeps TAI: a leap second reads as the second
after it. Until it is set it counts microseconds from 0 at the start. Stellar aberration (up to 20.5 arcsec)
is corrected once it is set; the known driver does not set it by itself. Set time is in force at the start
of the next frame; the device takes it for the moment when the request's last bit arrived. Setting
`set_time_words` is for an OBC that sends the upper word first.

## Subscription

Set by parameter 18: 84 frames, also between the replies to requests. Telemetry of frames comes with every
n-th frame when its result is there, n the fewest that keep the rate: solutions at 5 Hz or the frame rate,
whichever is less, all others at 1 Hz (ASSUMED, from the simulator; settings `solution_rate_hz`,
`other_rate_hz`). A dropped frame has an invalid solution at its own time. While the device looks at no
frames (STANDBY, FAULT), solutions are sent invalid at the frames' starts: a driver keeps the last flag
while nothing comes. Temperature (`temperature_rate_hz`), power and time come at their own period from the
subscription on. An id that stands in two slots comes once.

ASSUMED: subscribed telemetry that would make more than `most_frames_per_s` frames in any second, replies
included, is left out, the newest first: the driver takes one frame each 100 ms and clears its buffer over
more.

## Attitude

Quaternions are passive, inertial (ICRS) to the unit's frame: C = (w^2 - v.v) I + 2 v v' - 2 w [v x] takes
inertial components of a vector to the unit's, as the driver has it; products are those of the matrices. The
scalar is first and never negative. With setting `boresight` `+x` the unit's x is the device's boresight
(z), its y the columns (x), its z the rows (y): the fixed turn (w, x, y, z) = (0.5, -0.5, -0.5, -0.5); with
`+z` the frame is the device's.

`valid` is 1 (setting `validation`) when the device calls the attitude valid and, by parameter 15,
`stable_count` solutions in a row each differ by `max_difference_deg` or less from the one before,
`min_stars` are matched, and in tracking the confidence is `min_confidence` or more. ASSUMED: that they work
like this. Before the parameter is set its defaults count. A frame without attitude starts the count anew.
The limits are looked at when a frame's result is there. Exclusion angles, rates and stray light are the
device's: it is blinded by what its sensor sees, and there is no flag of its own for it. Where there is no
attitude the last one is sent with valid 0, as the simulator does (setting `hold_quaternion`).

Before the OBC sets them, the figures of the unit file are in force (exposure and so on), not the defaults
of the parameters (ASSUMED: those are one mission's for its own unit).

## What the known driver does

| Topic | What to know |
|-------|--------------|
| Polls | each 100 ms, one frame a poll; a frame cut by a poll is lost: the unit sends without gaps |
| Lengths | never checked: fields are read at fixed places |
| Hash | looked at and logged, the data are used anyhow |
| Status | stored, never acted on |
| Length of the quaternion | with valid 1, off 1 by more than 0.001 is an error there |
| Time | low 32 bits of the microseconds, over 1000: turns over each 4294.967 s |
| Start | power, 2 s, boot, 2 s, parameters at 1 Hz, then the subscription; no set time |
"""


SCENARIO = """\
## Telecommands of a scenario

| Name | What is sent | Fields |
|------|--------------|--------|
| `set_NAME` | parameter NAME is set | those of its table; what is left out has its default |
| `read_NAME` | parameter NAME is read | none |
| `request_NAME` | telemetry NAME is requested | none |
| `boot` | action boot | `region` |
| `set_time` | action set time | `unix_us`, or `utc`: a date and time with its zone |

NAME is that of the headings above, as in `set_camera` with `fields = { exposure_s = 0.1 }`. The unit starts
in its boot loader (setting `boot_loader`): a scenario without `boot` sees no attitude. `raw_hex` is octets of
the line with their framing.
"""


def _example() -> list[str]:
    """Octets to check one's own hash and escapes by."""
    camera = body_of(MessageType.SET_PARAMETER_REPLY, 9, b"\0")
    frames = (
        ("OBC", "action boot, region 1", body_of(MessageType.ACTION, ActionId.BOOT, b"\1")),
        ("unit", "done", body_of(MessageType.ACTION_REPLY, ActionId.BOOT, b"\0")),
        ("OBC", "read parameter 9; escaped", body_of(MessageType.READ_PARAMETER, 9)),
        ("unit", "parameter 9 was set", camera),
        (
            "OBC",
            "request the solution",
            body_of(MessageType.REQUEST_TELEMETRY, TelemetryId.SOLUTION),
        ),
    )
    rows = [(who, meaning, f"`{frame_of(body).hex(' ').upper()}`") for who, meaning, body in frames]
    return [
        "## Examples",
        "",
        "Whole frames, with the default address. `st-emulator demo --dialect sagitta` shows an exchange.",
        "",
        *table(("From", "Meaning", "On the line"), rows),
    ]


def _settings() -> list[str]:
    schema: dict[str, Any] = SagittaSettings.model_json_schema()
    rows = []
    for name, entry in schema["properties"].items():
        allowed = " or ".join(f'"{choice}"' for choice in entry.get("enum", ()))
        if entry["type"] == "boolean":
            allowed = "true or false"
        elif "minimum" in entry:
            allowed = f"{entry['minimum']:g} to {entry['maximum']:g}"
        default = entry["default"]
        shown = str(default).lower() if isinstance(default, bool) else f"{default}"
        rows.append((f"`{name}`", shown, allowed, entry["description"]))
    return table(("Setting", "Default", "Allowed", "Meaning"), rows)


def interface_document() -> str:
    """The document, Markdown."""
    lines = [
        INTRODUCTION,
        *message_chapters(),
        *_example(),
        BEHAVIOUR,
        SCENARIO,
        "## Settings: quirks and what can be chosen",
        "",
        "In `[dialects.sagitta]`; defaults are as the real unit does it, as far as that is known.",
        "",
        *_settings(),
    ]
    return "\n".join(lines).rstrip() + "\n"
