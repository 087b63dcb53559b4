"""The interface document of the dialect, from its message definitions and settings."""

from __future__ import annotations

from ...protocol.exporters.markdown import table
from ...protocol.nos3.messages import COMMAND, HEADER, LAYOUTS, TRAILER, Layout, Message
from ...protocol.nos3.quantisation import HIGHEST, OFFSET, SCALE, component_of, quantised
from .answering import MOST_WAITING
from .settings import Nos3Settings

INTRODUCTION = """\
# Interface: dialect `nos3`

NASA's generic star tracker, the component `generic_star_tracker` of the NASA Operational Simulator for
Small Satellites. Choose it in a unit file with `dialect = "nos3"` in `[wire]`; its settings stand in
`[dialects.nos3]`. Sources: the driver (`fsw/shared`), the simulator (`sim/src`) and the README of
`nasa-itc/generic_star_tracker`; there is no hardware and no interface document by its authors. Where they
contradict each other a setting chooses. `ASSUMED:` marks what none of them says.

This document is generated from the message definitions (`protocol/nos3/messages.py`) and the settings.

## Line

A serial line at the unit's `wire.baud` (the reference: 115200), 8N1, raw. All numbers are unsigned and
big-endian; there is no check sum and no escape. The unit speaks only when it is asked.
"""

RECEPTION = """\
## Reception

A command is {octets} octets with header `{header}` and trailer `{trailer}` in their places, none of which
belonged to a command before; it is taken when its last octet has come. Octets may come in any pieces with
garbage before, between and behind commands: a header without its trailer hides no command, the search goes
on at its second octet. ASSUMED: no pause ends a command, as no source has a time limit on the unit's side.

| What comes | What the unit does |
|---|---|
| a known command | echo, then the reply if there is one |
| a well-formed command with an unknown number | silence (setting `echo`); it counts 1 |
| anything else: wrong header, wrong trailer, too short | silence; it counts nothing |
| anything while the unit boots, is off or disabled | lost |

ASSUMED: commands that come while an answer leaves wait for their turn, {waiting} at most; more are lost and
count nothing (a driver waits for each answer).
"""

BEHAVIOUR = """\
## Timing

| From | To | Time |
|---|---|---|
| last bit of a command | first bit of its echo | `timing.telecommand_latency_us`, or the answer before |
| last bit of the echo | first bit of the reply | `reply_delay_us` |
| first bit | last bit of a message of n octets | 10 n / baud: {echo_us:.1f} us for an echo at 115200 |

The driver clears its receive buffer before each command, waits 50 ms for the whole echo, then 50 ms for the
whole reply; what is later is an error. It compares the echo octet by octet. A housekeeping reply with a
wrong header or trailer is an error to it; a data reply is not: the driver goes on with its old values and
says nothing.

The reply holds what is true when its command's turn comes: the end of its latency, or of the answer before.

## Command counter

u32, it wraps. From 0 at power-on, the housekeeping reply to the nth accepted command reads 2n - 1 in the
simulator: a command counts 1 when its format is right and 1 when it is echoed, which is behind the making
of the reply (setting `counter`).

## Attitude

- **Order**: vector part in q0, q1, q2 (x, y, z), scalar part in q3.
- **Frame**: the boresight is +z, as the device's; x goes along the columns and y along the rows of the
  detector. ASSUMED: the reference says no more than that the axes are marked on its housing.
- **Direction**: from ICRS to tracker components, v_tracker = A(q) v_ICRS with A(q) = (w^2 - v.v) I + 2 v
  v^T - 2 w [v x] (setting `quaternion`). ASSUMED: the sign convention of the reference's source is not
  documented; the inertial frame of the reference is that of its simulation.
- **Sign**: q and -q are one attitude. ASSUMED: the one with a scalar part that is not negative is sent, as
  the device gives it.
- **16 bits**: u = trunc(q * {scale} + {offset}), in double precision; the driver computes q = (u -
  {offset}) / {scale}. It is never above the true component (up to rounding of doubles), up to 1 / {scale}
  below it and half of that on average: whoever adds half a step halves the largest error of the attitude,
  from 25.2 to 12.6 arcsec. It need not be normalised.
- **Valid**: 1 when the last frame gave an attitude. While it is 0 the last valid quaternion is repeated.
  ASSUMED: before the first valid one it is the identity (0, 0, 0, 1), so that a driver that normalises
  divides by something.
- **Age**: no message carries a time; the attitude is that of the last frame whose processing has ended. The
  on-board time cannot be set either, so that stellar aberration is never corrected: up to 20.5 arcsec.

Field of view, frame rate, exclusion angles and accuracy are those of the unit file. The reference's
simulation has 8 x 8 deg, a sample each 0.25 s, exclusion angles of 30 (Sun), 10 (Earth) and 10 deg (Moon),
noise of 2, 2 and 20 arcsec, no limit of the rate.
"""

STATES = """\
## States

The wire shows one bit of state, `valid`, and knows no command that changes one.

| Mode of the device | What the wire shows |
|---|---|
| OFF, BOOT | silence, octets are lost |
| STANDBY, SELF_TEST, FAULT | commands are answered, `valid` 0 |
| LOST_IN_SPACE | commands are answered, `valid` 0 until the first attitude |
| TRACKING | commands are answered, `valid` as the last frame |
| RATE_ONLY | commands are answered, `valid` 0: the language has no field for a rate |

After boot the unit goes to LOST_IN_SPACE by itself (setting `autonomous`); when it loses the stars it goes
back there. FAULT is left by a power cycle alone. Power on starts with counter, configuration and status 0.
ASSUMED: a warm reset, which the wire cannot ask for, keeps the counter.

In layout `readme` the configuration is the payload of the last `config` command; no source says what it
configures, so it changes nothing. ASSUMED: status bit 0 says that the unit went to FAULT, bit 1 that its
stored parameters were damaged and factory values are in force; no source gives any bit a meaning.
"""

SCENARIO = """\
## Telecommands of a scenario

Their names are those of the commands in the unit's layout; the one field is `payload`, 0 when it is left out.
`raw_hex` is octets of the line. The unit looks for its attitude without any.
"""


def interface_document() -> str:
    """The whole document, Markdown."""
    parts = [
        INTRODUCTION,
        *_message(COMMAND, "## Command, {octets} octets, and its echo"),
        "The echo is the command's octets as they came, payload included.\n",
        RECEPTION.format(
            octets=COMMAND.octets,
            header=HEADER.hex(" ").upper(),
            trailer=TRAILER.hex(" ").upper(),
            waiting=MOST_WAITING,
        ),
        *[part for layout in LAYOUTS.values() for part in _layout(layout)],
        BEHAVIOUR.format(echo_us=COMMAND.octets * 10 / 115200 * 1e6, scale=SCALE, offset=OFFSET),
        *_quantised_values(),
        STATES,
        SCENARIO,
        *_settings(),
    ]
    return "\n".join(parts).rstrip("\n") + "\n"


def _message(message: Message, heading: str) -> list[str]:
    rows = []
    offset = 0
    for field in message.fields:
        last = offset + field.octets - 1
        place = f"{offset}" if last == offset else f"{offset}..{last}"
        value = "" if field.fixed is None else f"{field.fixed:0{2 * field.octets}X}h"
        rows.append((place, f"`{field.name}`", f"u{8 * field.octets}", value, field.meaning))
        offset += field.octets
    return [
        heading.format(octets=message.octets) + "\n",
        *table(("Octet", "Field", "Type", "Value", "Meaning"), rows),
    ]


def _layout(layout: Layout) -> list[str]:
    parts = [f"## Layout `{layout.name}`: {layout.source}\n"]
    parts += table(
        ("Number", "Command", "Reply behind the echo", "Meaning"),
        [
            (
                command.number,
                f"`{command.name}`",
                "none" if command.reply is None else f"{command.reply.name}, {command.reply.octets} octets",
                command.meaning,
            )
            for command in layout.commands
        ],
    )
    if layout.name == "code":
        parts.append("`config` is unknown to the unit unless the setting `config_command` says otherwise.\n")
    for command in layout.commands:
        if command.reply is not None:
            parts += _message(command.reply, f"### Reply {command.reply.name}, {{octets}} octets")
    return parts


def _quantised_values() -> list[str]:
    ends = (-1.0, -0.5, 0.0, 0.5, 1.0)
    rows = [(f"{q:g}", quantised(q), f"{component_of(quantised(q)):.7f}") for q in ends]
    return [
        *table(("Component", "u", "As the driver reads it"), rows),
        f"0, to the driver {component_of(0):.7f}, is sent only where rounding of doubles has brought a "
        f"component below -1.\nASSUMED: what is beyond 0 to {HIGHEST} would be sent as the nearest of the "
        "two; the device has none.\n",
    ]


def _settings() -> list[str]:
    rows = []
    for name, schema in Nos3Settings.model_json_schema()["properties"].items():
        if "enum" in schema:
            allowed = " or ".join(f'`"{choice}"`' for choice in schema["enum"])
        elif schema["type"] == "integer":
            allowed = f"{schema['minimum']} to {schema['maximum']}"
        else:
            allowed = "`true` or `false`"
        default = schema["default"]
        shown = str(default).lower() if isinstance(default, bool) else repr(default).replace("'", '"')
        rows.append((f"`{name}`", allowed, f"`{shown}`", schema["description"]))
    return ["## Settings, `[dialects.nos3]`\n", *table(("Setting", "Allowed", "Default", "Meaning"), rows)]
