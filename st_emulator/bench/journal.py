"""The journal: the raw bytes of both directions with their virtual times, as JSON lines.

First line: what was run (format, unit file, scenario, seed, stored parameters), so that a journal can be
replayed alone. Then one line a group of bytes: ``{"t_ns": 1234, "rx": "c0..."}`` when the OBC's bytes were
put on the line, ``"tx"`` when the unit's last bit of the group has left. On a CAN bus a group is the record
of a frame (see ``protocol.can.frames``); ``"refused"`` is one that the link did not take. What somebody did
to the run from outside stands there as well: ``"inject"`` is a fault that was put in live, ``"stand"`` one of
somebody's own, ``"clear"`` the number of one that was ended so, ``"power"`` its switch, ``"truth"`` a sample
of the true attitude. What came at one instant was there before anything else of that instant happened, unless
``"settle"`` stands between: then what was due had happened. ``"note"`` is for people. It holds virtual times
only: the same run gives the same file at any speed.
"""

from __future__ import annotations

import gzip
import json
import lzma
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from ..errors import ConfigurationError

FORMAT = "st-emulator journal 1"
DIRECTIONS = ("rx", "tx", "refused")
DOINGS = ("inject", "stand", "clear", "power", "truth", "settle")


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


Line = JournalEntry | JournalDoing
OPENERS: dict[str, Callable[..., Any]] = {".gz": gzip.open, ".xz": lzma.open}


class JournalReader:
    """A journal, a line at a time: :attr:`header` first, then what iteration gives, in its order. A last line
    cut short by a kill is left out. A name that ends in .gz or .xz is a compressed journal.

    ``end_ns`` and ``ended`` (it has its end mark) are true when the iteration is through.

    Raises:
        ConfigurationError: the file is no journal; the message names the file and line.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.end_ns = 0
        self.ended = False
        objects = self._objects()
        first = next(objects, None)
        if first is None or first.get("format") != FORMAT:
            raise ConfigurationError(
                f'{self.path}: not a journal: the first line must say "format": "{FORMAT}"'
            )
        self.header: dict[str, Any] = first
        self._rest = objects

    def __iter__(self) -> Iterator[Line]:
        for number, item in enumerate(self._rest, start=2):
            try:
                line = self._line(number, item)
            except (KeyError, ValueError, TypeError) as error:
                raise ConfigurationError(
                    f"{self.path}: line {number}: expected t_ns and rx or tx in hexadecimal"
                ) from error
            if line is not None:
                yield line

    def _line(self, number: int, item: dict[str, Any]) -> Line | None:
        t_ns = int(item["t_ns"])
        self.end_ns = max(self.end_ns, t_ns)
        if "end" in item:
            self.ended = True
            return None
        if "packet" in item:
            raise ConfigurationError(
                f"{self.path}: line {number}: recorded when a scenario's telecommands on a CAN bus came in "
                "behind the transport; allowed are journals recorded anew"
            )
        if "note" in item:
            return None
        if (done := next((name for name in DOINGS if name in item), None)) is not None:
            return JournalDoing(t_ns, done, item[done])
        direction = next((name for name in DIRECTIONS if name in item), "rx")
        return JournalEntry(t_ns, direction, bytes.fromhex(item[direction]))

    def _objects(self) -> Iterator[dict[str, Any]]:
        """The objects of the lines; one line is read ahead, to know the last."""
        ahead: tuple[int, str] | None = None
        for number, line in enumerate(self._lines(), start=1):
            if ahead is not None:
                item = self._object(*ahead, last=False)
                assert item is not None
                yield item
            ahead = number, line
        if ahead is not None and (item := self._object(*ahead, last=True)) is not None:
            yield item

    def _lines(self) -> Iterator[str]:
        opened = OPENERS.get(self.path.suffix, open)
        try:
            with opened(self.path, "rt", encoding="utf-8", newline="\n") as file:
                for line in file:
                    yield line.removesuffix("\n")
        except (OSError, UnicodeDecodeError, EOFError, lzma.LZMAError, zlib.error) as error:
            if isinstance(error, EOFError):
                return  # a compressed one whose writer was killed
            reason = getattr(error, "strerror", None) or "not a text file"
            raise ConfigurationError(
                f"{self.path}: cannot be read: {reason}; a journal is a file of JSON lines"
            ) from error

    def _object(self, number: int, line: str, *, last: bool) -> dict[str, Any] | None:
        try:
            item = json.loads(line)
        except (json.JSONDecodeError, RecursionError) as error:
            if last and number > 1:
                return None  # the writer was killed in the middle of its last line
            raise ConfigurationError(f"{self.path}: line {number}: not a JSON object") from error
        if not isinstance(item, dict):
            raise ConfigurationError(f"{self.path}: line {number}: not a JSON object")
        return item


@dataclass(frozen=True)
class Journal:
    """A journal read back whole.

    ``ended``: it has its end mark; without one the run was killed, and its last bytes may be missing.
    ``inputs``: received bytes, and what was done to the run, in their order.
    """

    header: dict[str, Any]
    entries: list[JournalEntry]
    end_ns: int
    ended: bool = True
    inputs: list[Line] = field(default_factory=list)

    def bytes_of(self, direction: str) -> bytes:
        """All bytes of a direction, joined."""
        return b"".join(entry.data for entry in self.entries if entry.direction == direction)


def is_input(line: Line) -> bool:
    """Whether it came from outside."""
    return isinstance(line, JournalDoing) or line.direction == "rx"


def read_journal(path: str | Path) -> Journal:
    """Read a journal whole; a last line cut short by a kill is left out.

    Raises:
        ConfigurationError: the file is no journal; the message names the file and line.
    """
    reader = JournalReader(path)
    lines = list(reader)
    return Journal(
        reader.header,
        [line for line in lines if isinstance(line, JournalEntry)],
        reader.end_ns,
        reader.ended,
        [line for line in lines if is_input(line)],
    )
