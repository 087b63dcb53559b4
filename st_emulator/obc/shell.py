"""The OBC's shell: commands typed one by one, with line editing at a terminal."""

from __future__ import annotations

import cmd
import contextlib
import sys
from collections.abc import Callable, Iterable
from typing import TextIO

from ..links import LinkError
from ..protocol.pus.enumerations import EventId, HousekeepingId, MemoryId, Mode, ParameterId
from ..protocol.pus.registry import REGISTRY
from .bus import CYCLIC_NAMES
from .commands import COMMANDS, parse_line
from .desk import CommandError
from .session import Line, Session

PROMPT = "obc> "
LEAVING = ("quit", "exit", "bye")
_WORDS: dict[str, list[str]] = {
    "get": [name.lower() for name in ParameterId.__members__],
    "set": [name.lower() for name in ParameterId.__members__],
    "hk": ["on", "off", "now", *(name.lower() for name in HousekeepingId.__members__)],
    "event": ["on", "off", *(name.lower() for name in EventId.__members__)],
    "wait-event": [name.lower() for name in EventId.__members__],
    "wait-mode": [name.lower() for name in Mode.__members__],
    "dump": [name.lower() for name in MemoryId.__members__],
    "load": [name.lower() for name in MemoryId.__members__],
    "check": [name.lower() for name in MemoryId.__members__],
    "cyclic": [*CYCLIC_NAMES, "attitude"],
    "send": [message.name for message in REGISTRY.telecommands()],
    "help": list(COMMANDS),
}


def run_shell(session: Session, complain: Callable[[str], None], source: TextIO | None = None) -> bool:
    """Read and run commands until quit or the end of `source` (standard input). Whether all were done.

    A command that fails is told and the shell goes on; only a link that has gone ends it. At a terminal the
    person has seen what failed, so that all counts as done.
    """
    source = sys.stdin if source is None else source
    shell = _Shell(session, complain)
    if source.isatty():
        session.say("help lists the commands, quit leaves")
        with contextlib.suppress(ImportError):  # a Python without line editing
            import readline

            readline.set_completer_delims(" \t\n")  # commands hold "-"
        while True:
            try:
                shell.cmdloop()
                break
            except KeyboardInterrupt:
                session.say("interrupted")
        return True
    shell.run(source)
    return shell.all_done


class _Shell(cmd.Cmd):
    """cmd.Cmd for prompt, line editing and completion; the commands are ours."""

    prompt = PROMPT

    def __init__(self, session: Session, complain: Callable[[str], None]) -> None:
        super().__init__()
        self.all_done = True
        self._session = session
        self._complain = complain
        self._line_number = 0
        self._events_shown = len(session.obc.events())
        self.identchars += "-"  # commands hold it

    def run(self, lines: Iterable[str]) -> None:
        """Run lines that nobody types."""
        for line in lines:
            if self.onecmd(line.rstrip("\n")):
                break

    def onecmd(self, line: str) -> bool:
        """Run one line; True ends the shell."""
        self._line_number += 1
        text = line.strip()
        if text.lower() in LEAVING or text == "EOF":
            return True
        try:
            action = parse_line(text)
        except CommandError as error:
            self._fail(str(error))
            return False
        if action is None:
            return False
        outcome = self._session.run(Line(f"line {self._line_number}", text, action))
        if outcome.error is not None:
            self._fail(outcome.error)
        self._show_events()
        return self._link_is_gone()

    def completenames(self, text: str, *ignored: object) -> list[str]:
        """Commands that begin with `text`."""
        return [name + " " for name in (*COMMANDS, "quit") if name.startswith(text)]

    def completedefault(self, *ignored: object) -> list[str]:
        """Arguments that begin with what stands before the cursor."""
        text, line = str(ignored[0]), str(ignored[1])
        words = _WORDS.get(line.split()[0].lower() if line.split() else "", [])
        return [word for word in words if word.startswith(text.lower())]

    def _fail(self, text: str) -> None:
        self.all_done = False
        self._complain(text)

    def _show_events(self) -> None:
        """Events since the last prompt."""
        events = self._session.obc.events()
        for event in events[self._events_shown :]:
            self._session.say(f"  event {event}")
        self._events_shown = len(events)

    def _link_is_gone(self) -> bool:
        try:
            self._session.obc.wait(0)
        except LinkError as error:
            self._fail(str(error))
            return True
        return False
