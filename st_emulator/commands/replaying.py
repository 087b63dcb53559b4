"""``st-emulator replay``: a journal's received bytes to a fresh unit, and what it sends against what it
sent.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from ..bench.emulator import Emulator
from ..bench.journal import Journal, JournalEntry, JournalReader, Line, TextSink, is_input
from ..bench.scenario import Scenario
from ..clock import NS_PER_S
from ..device.imaging import FrameRecord
from ..device.store import StoreContents, VolatileStore
from ..errors import ConfigurationError
from ..protocol.pus.enumerations import StoreInvalidCause
from ..report import check, require_json_path, show_checks, show_figures, write_json
from ..units.profile import UnitProfile
from ..units.validation import validate
from ..wire.can.wiring import CanWiring
from ..world.recorded import RecordedFrameError, RecordedFrames
from ..world.sampled import BeyondTruthError, SampledTrajectory
from .output_file import OutputFile


def emulator_of(source: Journal, where: str, **arguments: Any) -> Emulator:
    """A fresh emulator as the journal's first line describes it; its scenario's telecommands come from
    the entries.
    """
    header = source.header
    try:
        profile = validate(UnitProfile, header["unit"], where)
        scenario = validate(Scenario, header["scenario"], where)
        stored = header["store"]
        store = VolatileStore(
            StoreContents(dict(stored["parameters"]), int(stored["boot_count"])),
            None if stored["fault"] is None else StoreInvalidCause(stored["fault"]),
        )
        frames = None
        if header["frames"] is not None:
            frames = RecordedFrames(
                [Path(name) for name in header["frames"]], profile.detector.columns, profile.detector.rows
            )
        truth = header.get("truth")
        if truth not in (None, "samples"):
            raise ConfigurationError(
                f"{where}: line 1: the truth of this run came from a program that gave no samples; allowed "
                "are journals whose truth stands in them"
            )
        # The bytes of the scenario's own telecommands stand in the journal like any others.
        scenario = scenario.model_copy(update={"telecommands": [], "parameters": {}})
        return Emulator(
            profile,
            scenario,
            seed=int(header["seed"]),
            trajectory=None if truth is None else SampledTrajectory(),
            frames=frames,
            hold=int(header.get("hold", 1)),
            store=store,
            pace_reception=bool(header["pace_reception"]),
            baud=int(header["baud"]),
            can=None if header.get("can") is None else CanWiring(**header["can"]),
            **arguments,
        )
    except (RecordedFrameError, ConfigurationError):
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigurationError(
            f"{where}: line 1: the journal's first line is damaged: {error!r}"
        ) from error


def feed(emulator: Emulator, journal: Journal, until_ns: int | None = None) -> None:
    """Give the received bytes at their times, and run to the journal's end (or ``until_ns``)."""
    end_ns = journal.end_ns if until_ns is None else until_ns
    for one in journal.inputs:
        if one.t_ns > end_ns:
            continue
        if one.t_ns > emulator.now_ns:
            _advance(emulator, one.t_ns)
        if isinstance(one, JournalEntry):
            emulator.receive(one.data)
        else:
            emulator.do(one.what, one.content)
    _advance(emulator, end_ns)


def _advance(emulator: Emulator, until_ns: int) -> None:
    """Let virtual time go on; as in the recorded run it may stay at an instant whose truth is to come."""
    try:
        emulator.advance(until_ns)
    except BeyondTruthError:
        if emulator.now_ns < until_ns:
            raise


def refusals_of(journal: Journal) -> set[tuple[int, bytes]]:
    """The CAN frames that the link did not take, with their times: they are inputs of the run, too."""
    return {(entry.t_ns, entry.data) for entry in journal.entries if entry.direction == "refused"}


def first_difference(recorded: list[JournalEntry], replayed: list[JournalEntry]) -> str | None:
    """Where two series of transmitted groups part, or None."""
    for number, (one, other) in enumerate(zip(recorded, replayed, strict=False)):
        if one != other:
            return f"group {number} at {one.t_ns / NS_PER_S:.9f} s against {other.t_ns / NS_PER_S:.9f} s"
    if len(recorded) != len(replayed):
        return f"{len(recorded)} groups against {len(replayed)}"
    return None


class Comparison:
    """What was sent against what is sent now, group by group, as both come."""

    def __init__(self) -> None:
        self.recorded: deque[JournalEntry] = deque()
        self.replayed: deque[JournalEntry] = deque()
        self.difference: str | None = None
        self.tx_bytes = self.tx_bytes_replayed = 0
        self._groups = 0

    def sent(self, entry: JournalEntry) -> None:
        """The journal has it."""
        self.tx_bytes += len(entry.data)
        self.recorded.append(entry)

    def sends(self, entry: JournalEntry) -> None:
        """The replay has it."""
        self.tx_bytes_replayed += len(entry.data)
        self.replayed.append(entry)

    def compare(self) -> None:
        """As far as both have come."""
        while self.recorded and self.replayed:
            one, other = self.recorded.popleft(), self.replayed.popleft()
            if one != other and self.difference is None:
                times = f"{one.t_ns / NS_PER_S:.9f} s against {other.t_ns / NS_PER_S:.9f} s"
                self.difference = f"group {self._groups} at {times}"
            self._groups += 1

    def end(self, ended: bool, end_ns: int) -> None:
        """Both are through. A run that was killed (not ``ended``) could not write all that it sent in its
        last instant: that is not compared.
        """
        self.compare()
        if not ended:
            while self.replayed and self.replayed[-1].t_ns >= end_ns:
                self.tx_bytes_replayed -= len(self.replayed.pop().data)
        if self.difference is None and (self.recorded or self.replayed):
            counts = (self._groups + len(part) for part in (self.recorded, self.replayed))
            self.difference = "{} groups against {}".format(*counts)


class Replay:
    """A journal that is run again while it is read: nothing of it is held for longer than it is needed.

    Args:
        path: the journal.
        journal: where the replay writes its own, or None.
        progress: called with the virtual time reached, ns.
    """

    MOST_WAITING = 10_000
    """Entries read ahead of the time reached, to know which frames the link will not take."""

    def __init__(
        self,
        path: Path,
        journal: TextSink | None = None,
        progress: Callable[[int], None] = lambda t_ns: None,
    ) -> None:
        self.reader = JournalReader(path)
        self.comparison = Comparison()
        self.rx_bytes = 0
        self._refusals: set[tuple[int, bytes]] = set()
        self._progress = progress
        header = Journal(self.reader.header, [], 0)
        self.emulator = emulator_of(header, str(path), transmit=self._transmit, journal=journal)

    def _transmit(self, data: bytes, t_ns: int) -> int:
        if (t_ns, data) in self._refusals:
            return 0
        self.comparison.sends(JournalEntry(t_ns, "tx", data))
        return len(data)

    def run(self) -> None:
        """To the journal's end."""
        emulator, comparison = self.emulator, self.comparison
        given: Line | None = None  # an input whose followers are being read
        waiting = 0
        for line in self.reader:
            if is_input(line):
                self._give(given)
                given, waiting = line, 0
                continue
            assert isinstance(line, JournalEntry)
            if line.direction == "refused":
                self._refusals.add((line.t_ns, line.data))
            else:
                comparison.sent(line)
            waiting += 1
            if waiting >= self.MOST_WAITING and line.t_ns - 1 > emulator.now_ns:
                self._give(given)
                given, waiting = None, 0
                self._advance(line.t_ns - 1)
        self._give(given)
        self._advance(self.reader.end_ns)
        emulator.close()
        comparison.end(self.reader.ended, self.reader.end_ns)

    def _give(self, line: Line | None) -> None:
        if line is None:
            return
        if line.t_ns > self.emulator.now_ns:
            self._advance(line.t_ns)
        if isinstance(line, JournalEntry):
            self.rx_bytes += len(line.data)
            self.emulator.receive(line.data)
        else:
            self.emulator.do(line.what, line.content)

    def _advance(self, until_ns: int) -> None:
        _advance(self.emulator, until_ns)
        self.comparison.compare()
        self._refusals = {one for one in self._refusals if one[0] >= until_ns}
        self._progress(until_ns)


def replay_journal(path: Path, json_path: str | None, write: Path | None, console: Console) -> int:
    """Replay and compare; exit status 0 when every byte and time is the same."""
    require_json_path(json_path)
    with contextlib.ExitStack() as stack:
        text = None if write is None else stack.enter_context(OutputFile(write, "--write"))
        replay = Replay(path, text)
        replay.run()
    reader, comparison = replay.reader, replay.comparison
    difference = comparison.difference
    figures = {
        "seconds": reader.end_ns / NS_PER_S,
        "rx_bytes": replay.rx_bytes,
        "tx_bytes": comparison.tx_bytes,
        "tx_bytes_replayed": comparison.tx_bytes_replayed,
        "ended": reader.ended,
        "first_difference": difference or "none",
    }
    checks = [check("differences", int(difference is not None), "==", 0, "")]
    show_figures(console, f"replay of {path}", figures)
    show_checks(console, checks)
    write_json(json_path, figures, checks)
    return 0 if difference is None else 1


def frame_of(journal: Journal, where: str, frame_index: int) -> FrameRecord | None:
    """One processed frame of a journal, with its pixels and intermediates, by replaying up to it."""
    found: list[FrameRecord] = []
    refusals = refusals_of(journal)
    emulator = emulator_of(
        journal,
        where,
        on_completed=found.append,
        transmit=lambda data, t_ns: 0 if (t_ns, data) in refusals else None,
    )
    period_ns = emulator.profile.frame_period_ns
    feed(emulator, journal, min(journal.end_ns, (frame_index + 2) * period_ns))
    return next((record for record in found if record.index == frame_index), None)
