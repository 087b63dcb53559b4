"""The commands of the OBC's shell and scripts: a line of text becomes an action on an OBC.

A line is checked whole before anything is sent: names, numbers and their count. What the unit has to judge,
such as the range of a parameter, goes to the unit.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from ..naming import field_text, member, name_of, parameter_name
from ..protocol.pus.enumerations import (
    EventId,
    FailureCode,
    FunctionId,
    HousekeepingId,
    MemoryId,
    Mode,
    ParameterId,
    ResetKind,
)
from ..protocol.pus.fields import Field
from ..protocol.pus.housekeeping import HOUSEKEEPING
from ..protocol.pus.parameters import PARAMETERS
from ..protocol.pus.registry import REGISTRY
from ..tai import tai_ns_from_utc
from .bus_commands import BUS_WORDS
from .desk import Action, Arguments, CommandError, Desk, NotHeldError, number, octets, whole
from .errors import VerificationError
from .expectations import FORMS, OPERATORS, parse_expectation
from .image_file import IMAGE_SUFFIXES, write_image
from .verification import Verification
from .watching import attitude_line, rate_text

SHOWN_EVENTS = 20
ACQUIRE_TIMEOUT_S = 30.0
LONG_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Command:
    """A word, what may follow it, and how the words become an action."""

    name: str
    usage: str
    help: str
    least: int
    most: int | None
    parse: Callable[[Arguments], Action]


def parse_line(line: str) -> Action | None:
    """The action of a line, None when it is empty or a comment (#). CommandError when it is no command."""
    words = words_of(line)
    return _parse_words(words) if words else None


def words_of(line: str) -> list[str]:
    """The words of a line as a POSIX shell has them, without comment."""
    try:
        return shlex.split(line, comments=True)
    except ValueError as error:
        raise CommandError(f"{line.strip()}: {error}") from None


def _parse_words(words: Sequence[str]) -> Action:
    name, *arguments = words
    command = COMMANDS.get(name.lower())
    if command is None:
        raise CommandError(f"{name}: no such command; help lists them")
    if len(arguments) < command.least or (command.most is not None and len(arguments) > command.most):
        raise CommandError(f"{name}: write {command.name} {command.usage}".rstrip())
    try:
        return command.parse(arguments)
    except ValueError as error:
        raise CommandError(f"{name}: {error}") from None


def _seconds(arguments: Arguments, index: int, default: float) -> float:
    return number(arguments[index], "SECONDS", 0, 86_400) if len(arguments) > index else default


def _done(desk: Desk, verification: Verification) -> None:
    took = "" if verification.seconds is None else f" after {verification.seconds:.3f} s"
    steps = f", {len(verification.steps)} steps" if verification.steps else ""
    desk.say(f"{verification.label}: {verification.state.value}{took}{steps}")


# Connection, time, mode


def _ping(arguments: Arguments) -> Action:
    return lambda desk: desk.say(f"pong after {1000 * desk.obc.ping():.1f} ms")


def _set_time(arguments: Arguments) -> Action:
    moment = None
    if arguments and arguments[0] != "now":
        try:
            moment = datetime.fromisoformat(arguments[0])
        except ValueError:
            raise ValueError(f"{arguments[0]!r} is no time; write 2026-05-01T12:00:00Z or now") from None
        tai_ns_from_utc(moment)
    return lambda desk: _done(desk, desk.obc.set_time(moment))


def _function(function: FunctionId, timeout_s: float = LONG_TIMEOUT_S) -> Callable[[Arguments], Action]:
    def parse(arguments: Arguments) -> Action:
        limit_s = _seconds(arguments, 0, timeout_s)
        return lambda desk: _done(desk, desk.obc.function(function, timeout_s=limit_s))

    return parse


def _reset(arguments: Arguments) -> Action:
    kind = ResetKind(member(ResetKind, arguments[0])) if arguments else ResetKind.WARM
    return lambda desk: desk.say(str(desk.obc.reset(kind, LONG_TIMEOUT_S)))


def _track_from(arguments: Arguments) -> Action:
    parts = {
        f"q_{axis}": number(text, f"q_{axis}", -1, 1) for axis, text in zip("xyzw", arguments, strict=True)
    }
    return lambda desk: _done(
        desk, desk.obc.function(FunctionId.TRACK_FROM, timeout_s=LONG_TIMEOUT_S, **parts)
    )


def _wait(arguments: Arguments) -> Action:
    duration_s = _seconds(arguments, 0, 0)
    return lambda desk: desk.obc.wait(duration_s)


def _wait_mode(arguments: Arguments) -> Action:
    mode, timeout_s = member(Mode, arguments[0]), _seconds(arguments, 1, LONG_TIMEOUT_S)
    return lambda desk: desk.say(
        f"{name_of(Mode, mode)} after {desk.obc.wait_for_mode(Mode(mode), timeout_s):.3f} s"
    )


def _wait_event(arguments: Arguments) -> Action:
    event, timeout_s = name_of(EventId, member(EventId, arguments[0])), _seconds(arguments, 1, LONG_TIMEOUT_S)
    return lambda desk: desk.say(str(desk.obc.wait_for_event(event, timeout_s)))


# What the unit says of itself


def _status(arguments: Arguments) -> Action:
    return _report_housekeeping(HousekeepingId.STATUS)


def _report_housekeeping(structure: int) -> Action:
    def act(desk: Desk) -> None:
        values = desk.obc.housekeeping(structure)
        elements = HOUSEKEEPING[structure].fields
        units = {element.name: element.unit for element in elements if isinstance(element, Field)}
        for name, value in values.items():
            desk.say(f"{name:28} {field_text(elements, name, value)} {units.get(name, '')}".rstrip())

    return act


def _housekeeping(arguments: Arguments) -> Action:
    verb, structure = arguments[0].lower(), member(HousekeepingId, arguments[1])
    interval_s = number(arguments[2], "SECONDS", 0.25, 3600) if len(arguments) > 2 else None
    if verb == "now" and interval_s is None:
        return _report_housekeeping(structure)
    if verb == "on":
        return lambda desk: _done(desk, desk.obc.enable_housekeeping(structure, interval_s))
    if verb == "off" and interval_s is None:
        return lambda desk: _done(desk, desk.obc.disable_housekeeping(structure))
    raise ValueError(f"write on, off or now, not {' '.join(arguments)!r}; only on takes SECONDS")


def _events(arguments: Arguments) -> Action:
    count = whole(arguments[0], "N", 1, 10_000) if arguments else SHOWN_EVENTS

    def act(desk: Desk) -> None:
        events = desk.obc.events()
        for event in events[-count:]:
            desk.say(f"{(event.received_ns - desk.obc.started_ns) / 1e9:10.3f} s  {event}")
        if not events:
            desk.say("no events")

    return act


def _event(arguments: Arguments) -> Action:
    verb, numbers = arguments[0].lower(), [member(EventId, name) for name in arguments[1:]]
    if verb == "on":
        return lambda desk: _done(desk, desk.obc.enable_events(*numbers))
    if verb == "off":
        return lambda desk: _done(desk, desk.obc.disable_events(*numbers))
    raise ValueError(f"write on or off, not {arguments[0]!r}")


def _attitude(arguments: Arguments) -> Action:
    timeout_s = _seconds(arguments, 0, 2.0)

    def act(desk: Desk) -> None:
        desk.obc.next("attitude_report", timeout_s)
        attitude = desk.obc.attitudes()[-1]
        desk.say(attitude_line(attitude))
        if attitude.valid:
            desk.say(f"  rate {rate_text(attitude)}")

    return act


def _counters(arguments: Arguments) -> Action:
    def act(desk: Desk) -> None:
        for name, value in desk.obc.counters.as_dict().items():
            desk.say(f"{name:28} {value}")

    return act


def _watch(arguments: Arguments) -> Action:
    duration_s = _seconds(arguments, 0, 0) if arguments else None
    return lambda desk: desk.watch(desk.obc, duration_s)


# Parameters


def _get(arguments: Arguments) -> Action:
    numbers = [member(ParameterId, name) for name in arguments] or None

    def act(desk: Desk) -> None:
        for name, value in desk.obc.parameters(numbers).items():
            field = PARAMETERS[ParameterId[name.upper()]].field
            desk.say(f"{name:34} {field_text([field], field.name, value)} {field.unit}".rstrip())

    return act


def _set(arguments: Arguments) -> Action:
    if len(arguments) % 2:
        raise ValueError("every PARAM needs a VALUE")
    values: dict[str | int, int | float] = {}
    for name, text in zip(arguments[::2], arguments[1::2], strict=True):
        parameter = PARAMETERS.get(member(ParameterId, name))
        if parameter is None:
            raise ValueError(f"{name!r} is no parameter; get lists them")
        try:
            values[int(parameter.id)] = int(text, 0) if parameter.type.kind == "integer" else float(text)
        except ValueError:
            kind = "whole number" if parameter.type.kind == "integer" else "number"
            raise ValueError(f"{parameter_name(parameter.id)} is {text!r}; it is a {kind}") from None
    return lambda desk: _done(desk, desk.obc.set_parameters(values, strict=False))


# Memory and images


def _area(arguments: Arguments) -> tuple[int, int]:
    return member(MemoryId, arguments[0]), whole(arguments[1], "ADDRESS", 0, 0xFFFFFFFF)


def _dump(arguments: Arguments) -> Action:
    memory, address = _area(arguments)
    length = whole(arguments[2], "LENGTH", 1, 1 << 24)
    file = Path(arguments[3]) if len(arguments) > 3 else None

    def act(desk: Desk) -> None:
        data = desk.obc.memory_dump(memory, address, length)
        if file is not None:
            file.write_bytes(data)
            desk.say(f"{len(data)} bytes in {file}")
            return
        for offset in range(0, len(data), 16):
            row = data[offset : offset + 16]
            text = "".join(chr(value) if 32 <= value < 127 else "." for value in row)
            desk.say(f"{address + offset:08X}  {row.hex(' '):47}  {text}")

    return act


def _load(arguments: Arguments) -> Action:
    memory, address = _area(arguments)
    data = octets(arguments[2])

    def act(desk: Desk) -> None:
        for verification in desk.obc.memory_load(memory, address, data):
            _done(desk, verification)

    return act


def _check(arguments: Arguments) -> Action:
    memory, address = _area(arguments)
    length = whole(arguments[2], "LENGTH", 1, 65_535)
    return lambda desk: desk.say(f"CRC-16 0x{desk.obc.memory_check(memory, address, length):04X}")


def _image(arguments: Arguments) -> Action:
    file = Path(arguments[0])
    if file.suffix.lower() not in IMAGE_SUFFIXES:
        raise ValueError(f"{file} is no picture; allowed are {', '.join(IMAGE_SUFFIXES)}")

    def act(desk: Desk) -> None:
        desk.obc.capture_image()
        image = desk.obc.fetch_image()
        write_image(file, image.pixels)
        height, width = image.pixels.shape
        desk.say(f"frame {image.frame_index}, {width} x {height} pixels in {file}")

    return act


# Anything else that can go on the wire


def _send(arguments: Arguments) -> Action:
    name = arguments[0].lower()
    known = [message.name for message in REGISTRY.telecommands()]
    if name not in known:
        raise ValueError(f"{name!r} is no telecommand; there are {', '.join(known)}")
    fields: dict[str, Any] = {}
    for word in arguments[1:]:
        key, equals, value = word.partition("=")
        if not equals or not key:
            raise ValueError(f"{word!r} is no FIELD=VALUE")
        fields[key] = value
    return lambda desk: _done(desk, desk.obc.send(name, timeout_s=LONG_TIMEOUT_S, strict=False, **fields))


def _raw(framed: bool) -> Callable[[Arguments], Action]:
    def parse(arguments: Arguments) -> Action:
        data = octets(" ".join(arguments))
        return lambda desk: desk.say(f"{desk.obc.send_raw(data, framed=framed)} bytes sent")

    return parse


# What a script holds the unit to


def _expect(arguments: Arguments) -> Action:
    expectation = parse_expectation(*arguments)

    def act(desk: Desk) -> None:
        check = expectation.check(desk.obc)
        desk.checks.append(check)
        value = "none" if check.value is None else expectation.quantity.text(check.value)
        text = f"{check.name} is {value} {check.unit}".rstrip()
        if not check.holds:
            raise NotHeldError(f"{text}, expected {check.target}")
        desk.say(f"{text} ({check.target} holds)")

    return act


def _refused(arguments: Arguments) -> Action:
    code, action = member(FailureCode, arguments[0]), _parse_words(arguments[1:])
    wanted = name_of(FailureCode, code)

    def act(desk: Desk) -> None:
        try:
            action(desk)
        except VerificationError as error:
            if error.failure_code != code:
                raise NotHeldError(f"refused with {error.failure_name}, expected {wanted}") from None
            desk.say(f"refused as expected: {error}")
            return
        raise NotHeldError(f"was not refused, expected {wanted}")

    return act


def _help(arguments: Arguments) -> Action:
    if arguments and arguments[0] not in COMMANDS:
        raise ValueError(f"{arguments[0]!r} is no command")

    def act(desk: Desk) -> None:
        for command in [COMMANDS[arguments[0]]] if arguments else COMMANDS.values():
            desk.say(f"{command.name + ' ' + command.usage:44} {command.help}")

    return act


_F = FunctionId
_COMMANDS = (
    Command("help", "[COMMAND]", "this list", 0, 1, _help),
    Command("ping", "", "ask for a sign of life", 0, 0, _ping),
    Command("set-time", "[now|ISO]", "set the on-board time; now: this computer's", 0, 1, _set_time),
    Command(
        "acquire",
        "[SECONDS]",
        "find the attitude; SECONDS: how long to wait",
        0,
        1,
        _function(_F.START_ACQUISITION, ACQUIRE_TIMEOUT_S),
    ),
    Command("standby", "", "stop processing frames", 0, 0, _function(_F.GO_STANDBY)),
    Command("self-test", "", "test the unit", 0, 0, _function(_F.START_SELF_TEST)),
    Command("track-from", "X Y Z W", "track from a known q_icrs_to_sensor", 4, 4, _track_from),
    Command("reset", "[warm|cold]", "restart the unit", 0, 1, _reset),
    Command("shutdown", "", "shut the unit down", 0, 0, _function(_F.SHUTDOWN)),
    Command("status", "", "ask for housekeeping structure STATUS", 0, 0, _status),
    Command("attitude", "[SECONDS]", "show the next attitude report, with the rate", 0, 1, _attitude),
    Command("get", "[PARAM ...]", "show parameters, all when none is named", 0, None, _get),
    Command("set", "PARAM VALUE ...", "set parameters, all or none", 2, None, _set),
    Command(
        "restore-defaults",
        "",
        "set every parameter to its default",
        0,
        0,
        _function(_F.RESTORE_DEFAULT_PARAMETERS),
    ),
    Command("hk", "on|off|now STRUCTURE [SECONDS]", "housekeeping reports", 2, 3, _housekeeping),
    Command("clear-counters", "", "set the unit's counters to 0", 0, 0, _function(_F.CLEAR_COUNTERS)),
    Command("events", "[N]", "show the last events", 0, 1, _events),
    Command("event", "on|off NAME ...", "enable or disable event reports", 2, None, _event),
    Command("image", "FILE", "capture a frame and download it (.png, .tif, .npy)", 1, 1, _image),
    Command("dump", "MEMORY ADDRESS LENGTH [FILE]", "read memory", 3, 4, _dump),
    Command("load", "MEMORY ADDRESS HEX", "write memory", 3, 3, _load),
    Command("check", "MEMORY ADDRESS LENGTH", "checksum of memory", 3, 3, _check),
    Command("send", "TELECOMMAND [FIELD=VALUE ...]", "any telecommand by name", 1, None, _send),
    Command("raw", "HEX ...", "put octets on the wire as they are", 1, None, _raw(False)),
    Command("frame", "HEX ...", "put octets on the wire as one packet", 1, None, _raw(True)),
    *(Command(*word) for word in BUS_WORDS),
    Command("counters", "", "what this OBC has sent and received", 0, 0, _counters),
    Command("watch", "[SECONDS]", "live view, until Ctrl-C or for SECONDS", 0, 1, _watch),
    Command("wait", "SECONDS", "let time pass", 1, 1, _wait),
    Command("wait-mode", "MODE [SECONDS]", "wait for a mode", 1, 2, _wait_mode),
    Command("wait-event", "EVENT [SECONDS]", "wait for an event", 1, 2, _wait_event),
    Command("expect", "FIELD OP VALUE", f"{' '.join(OPERATORS)} on {FORMS}", 3, 3, _expect),
    Command("refused", "CODE COMMAND ...", "the unit must refuse COMMAND with CODE", 2, None, _refused),
)
COMMANDS: dict[str, Command] = {command.name: command for command in _COMMANDS}
"""By name, in the order of `help`."""
