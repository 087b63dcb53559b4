"""A client of the control socket, for another program's process. Of the standard library alone.

with LockstepClient("127.0.0.1", 4711, token) as unit:
    unit.set_attitude(0, [0, 0, 0, 1], [0, 0, 0])
    unit.set_attitude(250_000_000, [0, 0, 0, 1], [0, 0, 0])
    unit.step_to(250_000_000)
    print(unit.truth()["mode"], unit.take())
"""

from __future__ import annotations

import json
import socket
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from .drivers.lockstep_wire import VERSION, encoded


class ControlError(Exception):
    """The unit refused a request; ``kind``: one of ``lockstep_wire.ERROR_KINDS``, or "lost": the connection
    has gone.
    """

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(f"{kind}: {text}")
        self.kind = kind
        self.text = text


class LockstepClient:
    """A unit of another process, stepped or looked into.

    Args:
        host, port: where it listens.
        token: what its token file holds.
        timeout_s: how long an answer may take, so the longest step.

    ``hello``: what the unit said of itself; ``paused_because``: why the one before left it paused, or None.
    Every request raises ControlError where it is refused.
    """

    def __init__(self, host: str, port: int, token: str, *, timeout_s: float = 60.0) -> None:
        self._next = 0
        self._pending: list[int] = []
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
        except OSError as error:
            raise ControlError("lost", f"{host}:{port}: {error.strerror or error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._lines = self._socket.makefile("rb")
        try:
            self.hello = self.ask("hello", version=VERSION, token=token)
        except BaseException:
            self._close()
            raise
        self.paused_because: str | None = self.hello["because"]

    @classmethod
    def of_file(cls, host: str, port: int, token_file: str | Path, **more: Any) -> LockstepClient:
        """A client with the token of a file."""
        return cls(host, port, Path(token_file).read_text(encoding="ascii").strip(), **more)

    # -- any request

    def ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        """A request and its answer."""
        self.post(do, **arguments)
        return self.answers()[-1]

    def post(self, do: str, **arguments: Any) -> None:
        """A request whose answer is looked at with the next `answers`: several in one go are quicker. Not
        more than a hundred at once: their answers wait on the way.
        """
        self._next += 1
        self._send(encoded({"id": self._next, "do": do, **arguments}))
        self._pending.append(self._next)

    def answers(self) -> list[dict[str, Any]]:
        """The answers to all that was posted. Raises ControlError for the first one that was refused, when
        all are there.
        """
        found: list[dict[str, Any]] = []
        refused: ControlError | None = None
        while self._pending:
            answer = self._line()
            wanted = self._pending.pop(0)
            if not answer.get("ok"):
                error = answer.get("error", {})
                refused = refused or ControlError(str(error.get("kind")), str(error.get("text")))
                if answer.get("id") is None:
                    break  # it was not of this request, and nothing more will come
            elif answer.get("id") != wanted:
                raise ControlError(
                    "lost", f"an answer to {answer.get('id')} came in place of one to {wanted}"
                )
            found.append(answer)
        if refused is not None:
            self._pending.clear()
            raise refused
        return found

    def _send(self, line: bytes) -> None:
        try:
            self._socket.sendall(line)
        except OSError as error:
            last = self._last_words()
            raise last or ControlError("lost", str(error.strerror or error)) from error

    def _last_words(self) -> ControlError | None:
        """Why the unit closed the connection, when it said so."""
        try:
            error = json.loads(self._lines.readline())["error"]
            return ControlError(str(error["kind"]), str(error["text"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def _line(self) -> dict[str, Any]:
        try:
            line = self._lines.readline()
        except OSError as error:
            raise ControlError("lost", str(error.strerror or error)) from error
        if not line.endswith(b"\n"):
            raise ControlError("lost", "the unit has closed the connection")
        answer: dict[str, Any] = json.loads(line)
        return answer

    # -- truth in

    def set_attitude(
        self,
        t_ns: int,
        q_icrs_to_sensor: Iterable[float],
        rate_rad_s: Iterable[float] | None = None,
        *,
        position_km: Iterable[float] | None = None,
        velocity_km_s: Iterable[float] | None = None,
        sun_direction: Iterable[float] | None = None,
    ) -> None:
        """The truth at a virtual time, as `st_emulator.drivers.lockstep.Lockstep.set_attitude`."""
        self.post_attitude(
            t_ns,
            q_icrs_to_sensor,
            rate_rad_s,
            position_km=position_km,
            velocity_km_s=velocity_km_s,
            sun_direction=sun_direction,
        )
        self.answers()

    def post_attitude(
        self,
        t_ns: int,
        q_icrs_to_sensor: Iterable[float],
        rate_rad_s: Iterable[float] | None = None,
        **more: Any,
    ) -> None:
        """`set_attitude` that is answered together with the request behind it."""
        vectors = {"q_icrs_to_sensor": q_icrs_to_sensor, "rate_rad_s": rate_rad_s, **more}
        given = {name: [float(x) for x in value] for name, value in vectors.items() if value is not None}
        self.post("set_attitude", t_ns=int(t_ns), **given)

    # -- time

    def step_to(self, t_ns: int) -> int:
        """Go on to a virtual time; the time then."""
        return int(self.ask("step_to", t_ns=int(t_ns))["now_ns"])

    def step_frame(self, count: int = 1) -> int:
        """Go on until ``count`` more frame periods have begun; the time then."""
        return int(self.ask("step_frame", count=count)["now_ns"])

    def run_until(self, condition: Mapping[str, Any], limit_ns: int) -> bool:
        """Go on until all of a condition holds, at most to ``limit_ns``; whether it holds. Of ``mode`` (a
        name), ``valid``, ``sent_bytes`` (so many wait), ``counters`` (a table of least values).
        """
        return bool(self.ask("run_until", condition=dict(condition), limit_ns=int(limit_ns))["met"])

    def pause(self) -> None:
        """No more steps until `resume`."""
        self.ask("pause")

    def resume(self) -> None:
        """Steps are allowed again."""
        self.ask("resume")

    def state(self) -> dict[str, Any]:
        """The time, whether the unit is paused and why, whose the time and the truth are."""
        return self.ask("state")

    # -- the wire

    def receive(self, data: bytes) -> None:
        """The OBC puts bytes on the unit's wire at the present time."""
        for begin in range(0, len(data), 1 << 16):
            self.ask("receive", hex=data[begin : begin + (1 << 16)].hex())

    def take_groups(self) -> list[tuple[int, bytes]]:
        """What the unit has sent since the last call: (virtual time, bytes)."""
        groups: list[tuple[int, bytes]] = []
        more = True
        while more:
            answer = self.ask("take")
            groups += groups_of(answer["sent"])
            more = bool(answer["more"])
        return groups

    def take(self) -> bytes:
        """The bytes alone."""
        return b"".join(data for _, data in self.take_groups())

    # -- faults and what is true

    def inject(self, fault: Mapping[str, Any]) -> int:
        """Put a fault in; its number."""
        return int(self.ask("inject", fault=dict(fault))["number"])

    def clear(self, number: int) -> None:
        """End a fault."""
        self.ask("clear", number=number)

    def active_faults(self) -> Any:
        """The faults in force."""
        return self.ask("faults")["faults"]

    def truth(self) -> dict[str, Any]:
        """The true state of the unit, as `st_emulator.drivers.lockstep.UnitTruth`."""
        unit: dict[str, Any] = self.ask("truth")["unit"]
        return unit

    def truth_of_frame(self, frame_index: int) -> dict[str, Any]:
        """Time, true attitude and rate in the middle of a frame's exposure."""
        frame: dict[str, Any] = self.ask("truth", frame=frame_index)["frame"]
        return frame

    def power(self, on: bool) -> None:
        """Let power come on, or cut it."""
        self.ask("power", on=on)

    def flush(self) -> None:
        """Let the unit write out what its journal and truth file hold back."""
        self.ask("flush")

    def counters(self) -> dict[str, int]:
        """A snapshot of what is counted."""
        counters: dict[str, int] = self.ask("counters")["counters"]
        return counters

    # -- the end

    def close(self) -> None:
        """Leave: the unit waits, and a new client may go on at once."""
        try:
            self._pending.clear()
            self.ask("bye")
        except ControlError:
            pass
        finally:
            self._close()

    def _close(self) -> None:
        self._lines.close()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def groups_of(sent: Sequence[Sequence[Any]]) -> list[tuple[int, bytes]]:
    """The unit's bytes as an answer holds them."""
    return [(int(t_ns), bytes.fromhex(data)) for t_ns, data in sent]
