"""The journal: the raw bytes of both directions with their virtual times, as JSON lines.

First line: what was run (format, unit file, scenario, seed, stored parameters), so that a journal can be
replayed alone. Then one line a group of bytes: ``{"t_ns": 1234, "rx": "c0..."}`` when the OBC's bytes were
put on the line, ``"tx"`` when the unit's last bit of the group has left. On a CAN bus a group is the record
of a frame (see ``protocol.can.frames``); ``"refused"`` is one that the link did not take. What somebody did
to the run from outside stands there as well: ``"inject"`` is a fault that was put in live, ``"stand"`` one of
somebody's own, ``"clear"`` the number of one that was ended so, ``"truth"`` a sample of the true attitude.
``"note"`` is for people. It holds virtual times only: the same run gives the same file at any speed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from ..errors import ConfigurationError

FORMAT = "st-emulator journal 1"
DIRECTIONS = ("rx", "tx", "refused")
DOINGS = ("inject", "stand", "clear", "truth")


class TextSink(Protocol):
    """Where lines are written: an open text file."""

    def write(self, text: str, /) -> int: ...

    def flush(self) -> None: ...


@dataclass(frozen=True)
class JournalEntry:
    """Bytes of one direction: ``direction`` is "rx" (to the unit) or "tx" (from the unit); on a CAN bus also
    "refused" (from the unit, not taken by the link).
    """

    t_ns: int
    direction: str
    data: bytes


@dataclass(frozen=True)
class JournalDoing:
    """Something done to the run from outside: ``what`` is "inject" or "stand" (a fault's settings), "clear"
    (its number) or "truth" (a sample of the true attitude).
    """

    t_ns: int
    what: str
    content: Any


class JournalWriter:
    """Appends entries to an open text file."""

    def __init__(self, file: TextSink, header: dict[str, Any]) -> None:
        self._file = file
        self._file.write(json.dumps({"format": FORMAT, **header}, sort_keys=True) + "\n")

    def write(self, t_ns: int, direction: str, data: bytes) -> None:
        self._file.write(f'{{"t_ns": {t_ns}, "{direction}": "{data.hex()}"}}\n')

    def write_doing(self, t_ns: int, what: str, content: Any) -> None:
        """Something is done to the run from outside."""
        self._file.write(f'{{"t_ns": {t_ns}, "{what}": {json.dumps(content, sort_keys=True)}}}\n')

    def note(self, t_ns: int, text: str) -> None:
        """A line for people."""
        self._file.write(f'{{"t_ns": {t_ns}, "note": {json.dumps(text)}}}\n')

    def flush(self) -> None:
        self._file.flush()

    def end(self, t_ns: int) -> None:
        """Mark how far the run went, so that a replay runs as far."""
        self._file.write(f'{{"t_ns": {t_ns}, "end": true}}\n')
        self._file.flush()


@dataclass(frozen=True)
class Journal:
    """A journal read back.

    ``ended``: it has its end mark; without one the run was killed, and its last bytes may be missing.
    ``inputs``: received bytes, and what was done to the run, in their order.
    """

    header: dict[str, Any]
    entries: list[JournalEntry]
    end_ns: int
    ended: bool = True
    inputs: list[JournalEntry | JournalDoing] = field(default_factory=list)

    def bytes_of(self, direction: str) -> bytes:
        """All bytes of a direction, joined."""
        return b"".join(entry.data for entry in self.entries if entry.direction == direction)


def read_journal(path: str | Path) -> Journal:
    """Read a journal; a last line cut short by a kill is left out.

    Raises:
        ConfigurationError: the file is no journal; the message names the file and line.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise ConfigurationError(
            f"{path}: cannot be read: {reason}; a journal is a file of JSON lines"
        ) from error
    if lines and not lines[-1]:
        lines.pop()
    objects = list(_objects(path, lines))
    if not objects or objects[0].get("format") != FORMAT:
        raise ConfigurationError(f'{path}: not a journal: the first line must say "format": "{FORMAT}"')
    entries = []
    inputs: list[JournalEntry | JournalDoing] = []
    end_ns = 0
    ended = False
    for number, item in enumerate(objects[1:], start=2):
        try:
            end_ns = max(end_ns, int(item["t_ns"]))
            if "end" in item:
                ended = True
                continue
            if "packet" in item:
                raise ConfigurationError(
                    f"{path}: line {number}: recorded when a scenario's telecommands on a CAN bus came in "
                    "behind the transport; allowed are journals recorded anew"
                )
            if "note" in item:
                continue
            if (done := next((name for name in DOINGS if name in item), None)) is not None:
                inputs.append(JournalDoing(int(item["t_ns"]), done, item[done]))
                continue
            direction = next((name for name in DIRECTIONS if name in item), "rx")
            entry = JournalEntry(int(item["t_ns"]), direction, bytes.fromhex(item[direction]))
            entries.append(entry)
            if direction == "rx":
                inputs.append(entry)
        except (KeyError, ValueError, TypeError) as error:
            raise ConfigurationError(
                f"{path}: line {number}: expected t_ns and rx or tx in hexadecimal"
            ) from error
    return Journal(objects[0], entries, end_ns, ended, inputs)


def _objects(path: Path, lines: list[str]) -> Iterator[dict[str, Any]]:
    for number, line in enumerate(lines, start=1):
        try:
            item = json.loads(line)
        except (json.JSONDecodeError, RecursionError) as error:
            if number == len(lines) and number > 1:
                return  # the writer was killed in the middle of its last line
            raise ConfigurationError(f"{path}: line {number}: not a JSON object") from error
        if not isinstance(item, dict):
            raise ConfigurationError(f"{path}: line {number}: not a JSON object")
        yield item
