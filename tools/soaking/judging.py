"""What must hold of a run: its journal read by a decoder of its own, and replayed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from st_emulator.bench.journal import OPENERS, JournalEntry, JournalReader
from st_emulator.clock import NS_PER_S
from st_emulator.commands.replaying import Replay

from .run import Stretch
from .wire import kind_of

ATTITUDE_REPORT = (130, 1)
END = b"\xc0"


@dataclass
class Counted:
    """Of a journal: packets that could be read, attitude reports, and for each stretch those within it."""

    packets: int
    broken: int
    attitude_reports: int
    in_stretch: list[int]


def packets_of(path: Path) -> Iterator[tuple[int, bytes]]:
    """(time, frame) of everything that the unit sent between two END octets."""
    line = bytearray()
    for entry in JournalReader(path):
        if not isinstance(entry, JournalEntry) or entry.direction != "tx":
            continue
        line += entry.data
        last = line.rfind(END)
        if last < 0:
            continue
        for frame in line[:last].split(END):
            if frame:
                yield entry.t_ns, bytes(frame)
        del line[: last + 1]


def count(path: Path, stretches: Sequence[Stretch]) -> Counted:
    """Read the whole journal."""
    found = Counted(0, 0, 0, [0] * len(stretches))
    number = 0
    for t_ns, frame in packets_of(path):
        kind = kind_of(frame)
        found.broken += kind is None
        found.packets += kind is not None
        if kind != ATTITUDE_REPORT:
            continue
        found.attitude_reports += 1
        while number < len(stretches) and stretches[number].end_ns < t_ns:
            number += 1
        if number < len(stretches) and stretches[number].start_ns < t_ns:
            found.in_stretch[number] += 1
    return found


class HashedLines:
    """Takes a journal's lines behind its header, and forgets them."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self.lines = -1

    def write(self, text: str) -> int:
        if self.lines >= 0:
            self.digest.update(text.encode())
        self.lines += 1
        return len(text)

    def flush(self) -> None:
        pass


def replayed(path: Path, progress: Callable[[float], None]) -> str | None:
    """Replay it; None when it is the same line for line, else where it is not."""
    again = HashedLines()
    replay = Replay(path, again, lambda t_ns: progress(t_ns / NS_PER_S / 3600))
    replay.run()
    if replay.comparison.difference is not None:
        return replay.comparison.difference
    recorded = HashedLines()
    with OPENERS[path.suffix](path, "rt", encoding="utf-8", newline="\n") as file:
        for text in file:
            recorded.write(text)
    if recorded.digest.digest() != again.digest.digest():
        return f"the bytes are the same, the lines are not ({recorded.lines} against {again.lines})"
    return None


def growth_kib_per_hour(samples: Sequence[tuple[float, float]]) -> float | None:
    """Slope of the memory over the second half of a run, by least squares; None: too few samples."""
    late = samples[len(samples) // 2 :]
    if len(late) < 10:
        return None
    mean_h = sum(hours for hours, _ in late) / len(late)
    mean_mib = sum(mib for _, mib in late) / len(late)
    above = sum((hours - mean_h) * (mib - mean_mib) for hours, mib in late)
    below = sum((hours - mean_h) ** 2 for hours, _ in late)
    return 1024 * above / below
