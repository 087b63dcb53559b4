"""A run of commands: from lines of a script, of the command line or of a shell to outcomes and checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..links import LinkError
from ..protocol.errors import ProtocolError
from ..report import Check
from .client import Obc
from .commands import parse_line, words_of
from .desk import Action, CommandError, Desk, NotHeldError
from .errors import ObcError
from .expectations import mode_text

FAILURES = (ObcError, ProtocolError, LinkError, OSError, ValueError)


@dataclass(frozen=True)
class Line:
    """A line that has been understood: where it stands, what it says, what it does."""

    where: str
    text: str
    action: Action


@dataclass(frozen=True)
class Outcome:
    """What became of a line; `error` is None when it did what it should.

    `not_held`: it did what it should, but what it was to see did not hold.
    """

    where: str
    text: str
    error: str | None
    not_held: bool = False


@dataclass
class Session:
    """The commands of one run and what became of them."""

    obc: Obc
    say: Callable[[str], None]
    watch: Callable[[Obc, float | None], None]
    outcomes: list[Outcome] = field(default_factory=list)
    checks: list[Check] = field(default_factory=list)

    def run(self, line: Line) -> Outcome:
        """Do what a line says."""
        desk = Desk(self.obc, self.say, self.checks, self.watch)
        checks_before = len(self.checks)
        try:
            line.action(desk)
            outcome = Outcome(line.where, line.text, None)
        except NotHeldError as failure:
            outcome = Outcome(line.where, line.text, str(failure), not_held=True)
        except FAILURES as failure:
            outcome = Outcome(line.where, line.text, str(failure) or type(failure).__name__)
        self.outcomes.append(outcome)
        if len(self.checks) == checks_before:  # an expectation speaks for itself
            done = outcome.error is None
            self.checks.append(Check(line.text, done, "done", "", done))
        return outcome

    def run_all(self, lines: Sequence[Line], complain: Callable[[str], None]) -> bool:
        """Run a script. Whether everything held.

        An expectation that does not hold is noted and the script goes on; a command that fails ends it,
        since what follows rests on it.
        """
        for number, line in enumerate(lines):
            self.say(f"> {line.text}")
            outcome = self.run(line)
            if outcome.error is None:
                continue
            complain(f"{line.where}: {line.text}: {outcome.error}")
            if not outcome.not_held:
                if left := len(lines) - number - 1:
                    complain(f"{line.where}: stopped; commands not run: {left}")
                break
        return all(outcome.error is None for outcome in self.outcomes)

    def figures(self) -> dict[str, Any]:
        """The run in figures, for JSON."""
        return {
            "link": self.obc.link.name,
            **self.obc.transport.description,
            "apid": self.obc.destination_apid,
            "mode": mode_text(self.obc.unit.mode),
            "commands": [
                {"where": entry.where, "command": entry.text, "error": entry.error} for entry in self.outcomes
            ],
            "counters": self.obc.counters.as_dict(),
        }


def parse_lines(lines: Sequence[str], where: str) -> list[Line]:
    """Understand every line before any is run; CommandError names the first that is no command."""
    understood = []
    for number, text in enumerate(lines, start=1):
        place = f"{where} {number}"
        try:
            action = parse_line(text)
        except CommandError as error:
            raise CommandError(f"{place}: {error}") from None
        if action is not None:
            understood.append(Line(place, " ".join(words_of(text)), action))
    return understood
