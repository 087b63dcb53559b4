"""What a client of the control protocol can ask of a unit: a table of requests and how each is answered."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from ..clock import NS_PER_S
from ..errors import ConfigurationError
from ..firmware_model.modes import Mode
from ..world.sampled import BeyondTruthError, TruthSample
from .lockstep import Condition, Lockstep, LockstepError, PausedError
from .lockstep_wire import MOST_TAKEN_BYTES, LineError

Message = dict[str, Any]

LONGEST_STEP_NS = 86_400 * NS_PER_S
"""ASSUMED: nobody means a longer step; one that slipped would keep the computer for weeks."""
MOST_FRAMES = 1_000_000
END_OF_TIME_NS = 2**63 - 1


class Requests:
    """Answers requests of an authorised client.

    Args:
        lockstep: the unit.
        steps: whether the client owns the time; else it is paced by the computer's clock, and only faults,
            power, truth and counters are served.
        until_ns: the end of the run.
    """

    def __init__(self, lockstep: Lockstep, *, steps: bool, until_ns: int | None = None) -> None:
        self.lockstep = lockstep
        self.steps = steps
        self._until_ns = until_ns

    def state(self) -> Message:
        """What a client has to know before it goes on."""
        lockstep = self.lockstep
        return {
            "now_ns": lockstep.now_ns,
            "mode": lockstep.supervision.mode(),
            "time": "lockstep" if self.steps else "paced",
            "paused": lockstep.paused_because is not None,
            "because": lockstep.paused_because,
            "truth": "outside" if lockstep.truth_from_outside else "scenario",
            "next_frame_ns": lockstep.emulator.device.imaging.next_start_ns,
        }

    def answer(self, message: Message) -> Message:
        """The answer to a request but for its ``id`` and ``ok``.

        Raises:
            LineError: the request cannot be done; nothing has changed then, but that a step may have gone a
                part of its way.
        """
        name = message.get("do")
        request = REQUESTS.get(name) if isinstance(name, str) else None
        if request is None:
            raise LineError("unknown", f"do: found {name!r:.60}; allowed are {', '.join(REQUESTS)}")
        arguments = {key: value for key, value in message.items() if key not in ("id", "do")}
        for key in arguments:
            if key not in request.arguments and "*" not in request.arguments:
                allowed = ", ".join(request.arguments) or "none"
                raise LineError("argument", f"{name}: {key!r:.60} is not an argument; allowed: {allowed}")
        if request.of_time and not self.steps:
            raise LineError(
                "refused",
                f"{name}: the time of this run is the computer's; allowed in a run that was started with "
                "--lockstep",
            )
        try:
            return request.run(self, arguments)
        except PausedError as error:
            raise LineError("paused", str(error)) from error
        except LockstepError as error:
            raise LineError("refused", str(error)) from error
        except BeyondTruthError as error:
            raise LineError("beyond_truth", str(error)) from error

    # -- one by one

    def _state(self, arguments: Message) -> Message:
        return self.state()

    def _set_attitude(self, arguments: Message) -> Message:
        lockstep = self.lockstep
        if not lockstep.truth_from_outside:
            raise LineError(
                "refused",
                "set_attitude: the truth of this run is the scenario's; allowed in a run that was started "
                "with --attitude outside",
            )
        try:
            sample = TruthSample.of(arguments)
            lockstep.set_attitude(**vars(sample))
        except ValueError as error:
            raise LineError("argument", f"set_attitude: {error}") from error
        return {"now_ns": lockstep.now_ns}

    def _step_to(self, arguments: Message) -> Message:
        t_ns = _whole(arguments, "t_ns")
        self._check_end("t_ns", t_ns)
        self.lockstep.step_to(t_ns)
        return self._stepped(arguments)

    def _step_frame(self, arguments: Message) -> Message:
        count = _whole(arguments, "count", default=1, least=1, most=MOST_FRAMES)
        for _ in range(count):
            start_ns = self.lockstep.emulator.device.imaging.next_start_ns
            if start_ns is not None:
                self._check_end("the next frame", start_ns)
            self.lockstep.step_frame()
        return self._stepped(arguments)

    def _run_until(self, arguments: Message) -> Message:
        condition = _condition(arguments.get("condition"))
        limit_ns = _whole(arguments, "limit_ns")
        self._check_end("limit_ns", limit_ns)
        met = self.lockstep.run_until(condition, limit_ns)
        return {"met": met, **self._stepped(arguments)}

    def _check_end(self, what: str, t_ns: int) -> None:
        now_ns = self.lockstep.now_ns
        if self._until_ns is not None and t_ns > self._until_ns:
            raise LineError(
                "argument",
                f"{what}: {t_ns} ns; the run ends at {self._until_ns} ns, allowed are times up to it",
            )
        if t_ns - now_ns > LONGEST_STEP_NS:
            raise LineError(
                "argument",
                f"{what}: {t_ns} ns; allowed is up to {LONGEST_STEP_NS} ns after the present, {now_ns} ns",
            )

    def _stepped(self, arguments: Message) -> Message:
        answer: Message = {"now_ns": self.lockstep.now_ns}
        if arguments.get("take"):
            answer |= self._take({})
        return answer

    def _pause(self, arguments: Message) -> Message:
        self.lockstep.pause()
        return self.state()

    def _resume(self, arguments: Message) -> Message:
        self.lockstep.resume()
        return self.state()

    def _receive(self, arguments: Message) -> Message:
        try:
            data = bytes.fromhex(arguments["hex"])
        except (KeyError, TypeError, ValueError) as error:
            raise LineError("argument", "hex: allowed are pairs of hexadecimal digits") from error
        self.lockstep.receive(data)
        return {"now_ns": self.lockstep.now_ns}

    def _take(self, arguments: Message) -> Message:
        groups = self.lockstep.take_groups(MOST_TAKEN_BYTES)
        return {
            "sent": [[t_ns, data.hex()] for t_ns, data in groups],
            "more": self.lockstep.waiting_bytes > 0,
        }

    def _truth(self, arguments: Message) -> Message:
        if "frame" not in arguments:
            return {"unit": self.lockstep.truth().as_dict()}
        index = None if arguments["frame"] == "now" else _whole(arguments, "frame")
        try:
            return {"frame": self.lockstep.supervision.truth(index)}
        except ConfigurationError as error:
            raise LineError("argument", str(error)) from error

    def _power(self, arguments: Message) -> Message:
        on = arguments.get("on")
        if not isinstance(on, bool):
            raise LineError("argument", f"on: found {on!r:.60}; allowed are true and false")
        self.lockstep.power(on)
        return {}

    def _flush(self, arguments: Message) -> Message:
        self.lockstep.supervision.flush()
        return {}

    def _counters(self, arguments: Message) -> Message:
        return {"counters": self.lockstep.counters()}

    def _inject(self, arguments: Message) -> Message:
        fault = arguments.get("fault")
        if not isinstance(fault, Mapping):
            raise LineError("argument", "fault: allowed is a table as in a scenario's [[faults]]")
        try:
            return {"number": self.lockstep.inject(fault)}
        except (ConfigurationError, ValueError) as error:
            raise LineError("argument", f"fault: {error}") from error

    def _clear(self, arguments: Message) -> Message:
        number = _whole(arguments, "number")
        try:
            self.lockstep.clear(number)
        except (ConfigurationError, LookupError, ValueError) as error:
            raise LineError("argument", f"number: {error}") from error
        return {}

    def _faults(self, arguments: Message) -> Message:
        return {"faults": self.lockstep.active_faults()}


class Request:
    """A request: its arguments ("*": checked by what it does), whether it needs the time to be the
    client's.
    """

    def __init__(
        self,
        run: Callable[[Requests, Message], Message],
        *arguments: str,
        of_time: bool = False,
    ) -> None:
        self.run = run
        self.arguments = arguments
        self.of_time = of_time


REQUESTS: Final[dict[str, Request]] = {
    "state": Request(Requests._state),
    "set_attitude": Request(Requests._set_attitude, "*", of_time=True),
    "step_to": Request(Requests._step_to, "t_ns", "take", of_time=True),
    "step_frame": Request(Requests._step_frame, "count", "take", of_time=True),
    "run_until": Request(Requests._run_until, "condition", "limit_ns", "take", of_time=True),
    "pause": Request(Requests._pause, of_time=True),
    "resume": Request(Requests._resume, of_time=True),
    "receive": Request(Requests._receive, "hex", of_time=True),
    "take": Request(Requests._take, of_time=True),
    "truth": Request(Requests._truth, "frame"),
    "counters": Request(Requests._counters),
    "inject": Request(Requests._inject, "fault"),
    "clear": Request(Requests._clear, "number"),
    "faults": Request(Requests._faults),
    "power": Request(Requests._power, "on"),
    "flush": Request(Requests._flush),
}


def _whole(
    arguments: Message, name: str, *, default: int | None = None, least: int = 0, most: int = END_OF_TIME_NS
) -> int:
    value = arguments.get(name, default)
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise LineError(
            "argument", f"{name}: found {value!r:.60}; allowed is a whole number {least} to {most}"
        )
    return value


def _condition(value: Any) -> Condition:
    """All of: mode (a name), valid (true, false), sent_bytes (so many wait), counter with least."""
    allowed = "mode, valid, sent_bytes, counters (a table of least values)"
    if not isinstance(value, dict) or not value:
        raise LineError("argument", f"condition: allowed is a table with one or more of {allowed}")
    tests: list[Condition] = []
    for name, wanted in value.items():
        tests.append(_test(name, wanted, allowed))
    return lambda lockstep: all(test(lockstep) for test in tests)


def _test(name: str, wanted: Any, allowed: str) -> Condition:
    match name:
        case "mode" if isinstance(wanted, str) and wanted in Mode.__members__:
            mode = Mode[wanted]
            return lambda lockstep: lockstep.emulator.device.mode == mode
        case "mode":
            raise LineError(
                "argument", f"condition.mode: found {wanted!r:.60}; allowed are {', '.join(Mode.__members__)}"
            )
        case "valid" if isinstance(wanted, bool):
            return lambda lockstep: lockstep.emulator.device.attitude_valid == wanted
        case "sent_bytes" if isinstance(wanted, int):
            return lambda lockstep: lockstep.waiting_bytes >= wanted
        case "counters" if isinstance(wanted, dict) and all(isinstance(v, int) for v in wanted.values()):
            return lambda lockstep: _reached(lockstep.counters(), wanted)
    raise LineError("argument", f"condition.{name!s:.60}: {wanted!r:.60}; allowed are {allowed}")


def _reached(counters: dict[str, int], least: dict[str, int]) -> bool:
    missing = [name for name in least if name not in counters]
    if missing:
        raise LineError(
            "argument", f"condition.counters.{missing[0]!s:.60}: allowed are {', '.join(counters)}"
        )
    return all(counters[name] >= value for name, value in least.items())
