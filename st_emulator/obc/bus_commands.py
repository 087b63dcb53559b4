"""The commands that a CAN bus alone has: its cyclic frames, SYNC, any frame."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from ..naming import name_of
from ..protocol.can.cyclic import CAN_MESSAGES_BY_NAME, Signal
from ..protocol.can.frames import CLASSIC_BYTES, CanFrame
from ..protocol.errors import LocalProtocolError
from ..protocol.pus.enumerations import Reason
from ..tai import tai_ns_from_utc
from .bus import CYCLIC_NAMES
from .cuc_time import seconds
from .cyclic import CyclicAttitude, CyclicFrame
from .desk import Action, Arguments, Desk, octets

CYCLIC_TIMEOUT_S = 2.0
ATTITUDE = "attitude"
STANDARD_DIGITS, EXTENDED_DIGITS = 3, 8


def cyclic_line(frame: CyclicFrame, now_ns: int) -> str:
    """One cyclic frame in one line."""
    signals = CAN_MESSAGES_BY_NAME[frame.name].carried
    values = "  ".join(f"{signal.name} {_text(signal, frame.values[signal.name])}" for signal in signals)
    return f"{frame.name:18} {(now_ns - frame.time_ns) / 1e9:8.3f} s ago  {values}"


def cyclic_attitude_line(attitude: CyclicAttitude) -> str:
    """An attitude of the cyclic frames in one line."""
    ra, dec, roll = attitude.pointing_deg
    said = "nothing said of it" if attitude.valid is None else "valid"
    if attitude.reasons:
        said = f"not valid: {name_of(Reason, int(attitude.reasons))}"
    return f"counter {attitude.counter:3}  ra {ra:10.5f}  dec {dec:+9.5f}  roll {roll:9.4f} deg  {said}"


def _text(signal: Signal, value: float | int) -> str:
    if signal.choices is not None:
        return name_of(signal.choices, int(value))
    return f"{value:.9g} {signal.unit}".rstrip()


def _cyclic(arguments: Arguments) -> Action:
    name = arguments[0].lower().replace("-", "_") if arguments else ""
    if name and name not in (*CYCLIC_NAMES, ATTITUDE):
        raise ValueError(f"{name!r} is no cyclic frame; there are {', '.join((*CYCLIC_NAMES, ATTITUDE))}")

    def act(desk: Desk) -> None:
        obc = desk.obc
        if name == ATTITUDE:
            if not obc.cyclic_attitudes():
                obc.wait(CYCLIC_TIMEOUT_S)
            attitudes = obc.cyclic_attitudes()
            desk.say(cyclic_attitude_line(attitudes[-1]) if attitudes else "no attitude came")
            return
        frames = [frame for known in CYCLIC_NAMES if (frame := obc.cyclic(known)) is not None]
        if name:
            frames = [frame for frame in frames if frame.name == name]
            frames = frames or [obc.wait_for_cyclic(name, None, CYCLIC_TIMEOUT_S)]
        for frame in frames:
            desk.say(cyclic_line(frame, obc.now_ns()))
        if not frames:
            desk.say("no cyclic frames")

    return act


def _sync(arguments: Arguments) -> Action:
    moment = None
    if arguments and arguments[0] != "now":
        try:
            moment = datetime.fromisoformat(arguments[0])
        except ValueError:
            raise ValueError(f"{arguments[0]!r} is no time; write 2026-05-01T12:00:00Z or now") from None
        tai_ns_from_utc(moment)

    def act(desk: Desk) -> None:
        if arguments:
            desk.say(str(desk.obc.set_time_by_sync(moment)))
            return
        sent = desk.obc.sync()
        time = desk.obc.time_at_sync(sent, CYCLIC_TIMEOUT_S)
        desk.say(f"SYNC {sent.counter}: on-board time {seconds(time):.6f} s")

    return act


def _frame(arguments: Arguments) -> Action:
    identifier, data = arguments[0], octets(" ".join(arguments[1:]))
    extended = len(identifier) == EXTENDED_DIGITS
    try:
        number = int(identifier, 16) if extended or len(identifier) == STANDARD_DIGITS else -1
    except ValueError:
        number = -1
    if number < 0:
        raise ValueError(f"{identifier!r} is no identifier; write 3 hexadecimal digits, 8 for 29 bits")
    try:
        frame = CanFrame(number, data, extended, fd=len(data) > CLASSIC_BYTES)
    except LocalProtocolError as error:
        raise ValueError(str(error)) from None

    def act(desk: Desk) -> None:
        desk.obc.send_frame(frame)
        desk.say(f"{frame.candump()} sent")

    return act


BUS_WORDS: tuple[tuple[str, str, str, int, int | None, Callable[[Arguments], Action]], ...] = (
    ("cyclic", "[NAME]", "the last cyclic frames of a CAN bus; attitude: both halves", 0, 1, _cyclic),
    ("sync", "[now|ISO]", "send SYNC and show the unit's time at it; with a time: set it", 0, 1, _sync),
    ("can", "ID [HEX ...]", "put a frame on the CAN bus", 1, None, _frame),
)
"""Name, usage, help, least and most arguments, parser."""
