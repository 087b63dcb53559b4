"""Units in processes of their own, in real time, on a pseudo-terminal or a CAN bus that others may use too.

Such a process ends when the test run does, however that ends: it holds one end of a socket pair, and its
link goes with it.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..drivers.lockstep_wire import encoded
from ..errors import ConfigurationError
from ..links import Link, LinkError, open_link
from ..obc import Obc
from . import unit_server
from .errors import UnitDiedError
from .star_tracker import StarTracker

if TYPE_CHECKING:
    from ..bench.scenario import Scenario
    from ..units.profile import UnitProfile
    from .expectations import Expectations
    from .settings import UnitSettings

PATIENCE_S = 300.0
"""Only bounds a hang: on a new computer the kernels are compiled first."""
ENDING_S = 20.0
NODES = range(1, 128)
SAID_LINES = 20
_numbers = itertools.count(1)
_taken: set[Path] = set()  # link paths of this process


class _Server:
    """The process that units are forked from; there is one while units of this process need it."""

    def __init__(self) -> None:
        self.socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        package = Path(__file__).parents[2]
        path = os.pathsep.join(filter(None, (str(package), os.environ.get("PYTHONPATH"))))
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "st_emulator.testing.unit_server", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env=os.environ | {"PYTHONPATH": path},
            )

    def close(self) -> None:
        self.socket.close()
        try:
            self.process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


_servers: list[_Server] = []


def close_server() -> None:
    """No unit is needed any more."""
    while _servers:
        _servers.pop().close()


class UnitProcess:
    """A unit as ``st-emulator run --supervisor`` runs it, in a process of its own: asked as docs/lockstep.md
    says. One thread may ask at a time. ``options`` are those of the command.

    Raises:
        UnitDiedError: it has ended; the message says what it said.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        if not _servers or _servers[0].process.poll() is not None:
            close_server()
            _servers.append(_Server())
        self._socket, theirs = socket.socketpair()
        errors, their_errors = os.pipe()
        with theirs, os.fdopen(their_errors, "w"):
            folder = {"folder": os.getcwd()}
            unit_server.send(_servers[0].socket, options | folder, [theirs.fileno(), their_errors])
        self._socket.settimeout(PATIENCE_S)
        self._lines = self._socket.makefile("rb")
        self._said: deque[str] = deque(maxlen=SAID_LINES)
        self._errors = os.fdopen(errors, encoding="utf-8", errors="replace")
        self._reader = threading.Thread(target=self._read_said, daemon=True)
        self._reader.start()
        self._ids = itertools.count(1)
        self.pid: int | None = None

    def await_ready(self) -> None:
        """Return when all is loaded and the link is open."""
        self.pid = int(self._next()["ready"]["pid"])

    def ask(self, what: str, **arguments: Any) -> dict[str, Any]:
        """What it answers.

        Raises:
            ConfigurationError: it refused; one line says why.
        """
        number = next(self._ids)
        try:
            self._socket.sendall(encoded({"id": number, "do": what, **arguments}))
        except OSError:
            self.check()
            raise
        while (answer := self._next()).get("id") != number:
            pass
        if not answer["ok"]:
            raise ConfigurationError(answer["error"]["text"])
        return answer

    def check(self) -> None:
        """See that it is alive: its standard error is open for as long as it is."""
        if not self._reader.is_alive():
            said = " | ".join(self._said) or "it said nothing"
            raise UnitDiedError(f"the unit has ended: {said}")

    def close(self) -> None:
        """Let it end, and wait until it has."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        self._reader.join(ENDING_S)
        if self._reader.is_alive() and self.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            self._reader.join(ENDING_S)
        self._lines.close()
        self._socket.close()
        self._errors.close()

    def _next(self) -> dict[str, Any]:
        line = self._lines.readline()
        if not line:
            self._reader.join(ENDING_S)
            self.check()
        found: dict[str, Any] = json.loads(line)
        return found

    def _read_said(self) -> None:
        for line in self._errors:
            self._said.append(line.strip())


class _Asked:
    """Supervision over the descriptor."""

    def __init__(self, process: UnitProcess) -> None:
        self._ask = process.ask

    def now_ns(self) -> int:
        return int(self._ask("state")["now_ns"])

    def mode(self) -> str:
        return str(self._ask("state")["mode"])

    def truth(self, frame_index: int | None) -> dict[str, Any]:
        return dict(self._ask("truth", frame="now" if frame_index is None else frame_index)["frame"])

    def inject(self, fault: Mapping[str, Any]) -> int:
        return int(self._ask("inject", fault=dict(fault))["number"])

    def clear(self, number: int) -> None:
        self._ask("clear", number=number)

    def active(self) -> list[dict[str, Any]]:
        return list(self._ask("faults")["faults"])

    def power(self, on: bool) -> None:
        self._ask("power", on=on)

    def flush(self) -> None:
        self._ask("flush")


class ClaimedNode:
    """A node number of a CAN bus that no other test on this computer uses: an abstract socket's name, which
    the kernel gives free when its holder dies, and which is no file.

    ``wanted``: this one; None: the first that is free, from ``first`` on.
    """

    def __init__(self, channel: str, wanted: int | None, first: int) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        candidates = [wanted] if wanted is not None else [*range(first, NODES.stop), *range(1, first)]
        for number in candidates:
            try:
                self._socket.bind(f"\0st-emulator/{channel}/{number}")
            except OSError:
                continue
            self.number = number
            return
        self._socket.close()
        raise ConfigurationError(
            f"node {wanted} of {channel}: another test uses it; allowed is a free one (leave it out)"
            if wanted is not None
            else f"{channel}: all node numbers are in use"
        )

    def close(self) -> None:
        """Give it free."""
        self._socket.close()


class SpawnedStarTracker(StarTracker):
    """A unit that was started for the test."""

    def __init__(
        self,
        profile: UnitProfile,
        settings: UnitSettings,
        scenario: Scenario | None,
        bench: Expectations,
        journal: Path | None,
    ) -> None:
        specification = settings.link.specification
        assert specification is not None
        self._claimed: ClaimedNode | None = None
        self._path: Path | None = None
        node = None
        link = str(specification)
        if specification.kind == "can":
            channel = f"{specification.interface}/{specification.path}"
            self._claimed = ClaimedNode(channel, settings.node, profile.can.node)
            node = self._claimed.number
        elif specification.kind == "pty":
            self._path = pty_path(specification.path, profile.name)
            _taken.add(self._path)
            link = f"pty:{self._path}"
        super().__init__(profile, link, node, bench)
        self.journal = journal
        self._scenario = scenario
        self._begun = False
        self._begun_ns = 0
        self._unit = settings.unit
        if journal is not None:
            journal.parent.mkdir(parents=True, exist_ok=True)
        self.process = UnitProcess(
            {
                "unit": settings.unit,
                "dialect": settings.dialect,
                "link": link,
                "node": node,
                "store": "none",
                "journal": None if journal is None else str(journal),
            }
        )
        self.supervised = _Asked(self.process)
        try:
            self.process.await_ready()
        except BaseException:
            self.close()
            raise

    @property
    def mode(self) -> str:
        """The name of its mode; OFF as well before power comes on."""
        return self.supervised.mode() if self._begun else "OFF"

    def power_on(self) -> None:
        """Let power come on; it boots."""
        if self._begun:
            self.supervised.power(True)
            return
        table = None
        if self._scenario is not None:
            table = self._scenario.model_dump(mode="json", by_alias=True, exclude_unset=True)
        self.process.ask("begin", scenario=table)
        self._begun_ns = self._bench.now_ns
        self._begun = True

    def behind_ns(self) -> int:
        """How far it is behind the computer's clock."""
        if not self._begun:
            return 0
        return self._bench.now_ns - self._begun_ns - self.supervised.now_ns()

    def power_off(self) -> None:
        """Cut the power: it falls silent at once."""
        if self._begun:
            self.supervised.power(False)

    def close(self) -> None:
        """Its process ends, its link goes."""
        super().close()
        self.process.close()
        if self._claimed is not None:
            self._claimed.close()
        if self._path is not None:
            _taken.discard(self._path)
            if self._path.is_symlink():  # it was killed: its link goes as the next one's would
                from ..links.pty import PtyLink

                with contextlib.suppress(LinkError):
                    PtyLink(self._path).close()

    def _make_obc(self) -> Obc:
        return Obc.connect(self.link, unit=self._unit, node=self.node)

    def _make_line(self) -> Link:
        return open_link(self.link, "obc", self.profile.wire.baud, self.name, self.profile.can.bitrate)


def pty_path(wanted: str | None, name: str) -> Path:
    """A link path of this unit alone: in the user's runtime folder; or the one that was ``wanted``, with a
    suffix for another worker and for another unit at the same time.
    """
    if wanted is None:
        from ..links.pty import runtime_folder

        folder = runtime_folder() / "tests"  # apart from those that `st-emulator obc` finds by itself
        folder.mkdir(mode=0o700, exist_ok=True)
        return folder / f"{name}-{os.getpid()}-{next(_numbers)}"
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    for number in itertools.count(1):
        suffix = "-".join(filter(None, (worker, "" if number == 1 else str(number))))
        path = Path(f"{Path(wanted).expanduser().absolute()}{'-' + suffix if suffix else ''}")
        if path not in _taken:
            return path
    raise AssertionError
