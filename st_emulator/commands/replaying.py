"""``st-emulator replay``: a journal's received bytes to a fresh unit, and what it sends against what it
sent.
"""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

from rich.console import Console

from ..bench.emulator import Emulator
from ..bench.journal import Journal, JournalEntry, read_journal
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


def replay_journal(path: Path, json_path: str | None, write: Path | None, console: Console) -> int:
    """Replay and compare; exit status 0 when every byte and time is the same."""
    require_json_path(json_path)
    journal = read_journal(path)
    replayed: list[JournalEntry] = []
    with contextlib.ExitStack() as stack:
        text = io.StringIO() if write is None else stack.enter_context(OutputFile(write, "--write"))
        refusals = refusals_of(journal)

        def transmit(data: bytes, t_ns: int) -> int:
            if (t_ns, data) in refusals:
                return 0
            replayed.append(JournalEntry(t_ns, "tx", data))
            return len(data)

        emulator = emulator_of(journal, str(path), transmit=transmit, journal=text)
        feed(emulator, journal)
        emulator.close()
    recorded = [entry for entry in journal.entries if entry.direction == "tx"]
    if not journal.ended:
        # A run that was killed could not write all that it sent in its last instant: that is not compared.
        replayed = replayed[: len(recorded)] + [
            entry for entry in replayed[len(recorded) :] if entry.t_ns < journal.end_ns
        ]
    difference = first_difference(recorded, replayed)
    figures = {
        "seconds": journal.end_ns / NS_PER_S,
        "rx_bytes": len(journal.bytes_of("rx")),
        "tx_bytes": len(journal.bytes_of("tx")),
        "tx_bytes_replayed": sum(len(entry.data) for entry in replayed),
        "ended": journal.ended,
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
