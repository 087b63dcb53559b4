"""What users saw before stays as it was: kept journals are replayed to the same octets at the same times."""

from __future__ import annotations

import lzma
from pathlib import Path

import pytest

from st_emulator.bench.journal import JournalEntry, read_journal
from st_emulator.commands.replaying import emulator_of, feed, first_difference, refusals_of

KEPT = sorted(Path(__file__).parent.glob("*.jsonl.xz"))


def test_every_kind_of_run_is_kept() -> None:
    assert len(KEPT) >= 19


@pytest.mark.parametrize("kept", KEPT, ids=lambda path: path.name.split(".")[0])
def test_the_same_octets_at_the_same_times(kept: Path, tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(lzma.decompress(kept.read_bytes()))
    journal = read_journal(path)
    refusals = refusals_of(journal)
    replayed: list[JournalEntry] = []

    def transmit(data: bytes, t_ns: int) -> int:
        if (t_ns, data) in refusals:
            return 0
        replayed.append(JournalEntry(t_ns, "tx", data))
        return len(data)

    feed(emulator_of(journal, kept.name, transmit=transmit), journal)
    recorded = [entry for entry in journal.entries if entry.direction == "tx"]
    assert len(recorded) >= 5
    assert first_difference(recorded, replayed) is None
