"""What users saw before stays as it was: kept journals are replayed to the same octets at the same times.

A computer that rounds floating-point numbers differently (another processor, another linear algebra library)
cannot give the same octets: there the telemetry is compared, floats within a tolerance, and its times to
milliseconds, as an octet that has to be escaped moves what follows.
"""

from __future__ import annotations

import lzma
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from hil_tests.journals.numerics import RECORDED, numerics_digest, rounds_as_recorded
from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.reference_can import Peer
from st_emulator.bench.journal import Journal, JournalEntry, read_journal
from st_emulator.commands.replaying import emulator_of, feed, first_difference, refusals_of

KEPT = sorted(Path(__file__).parent.glob("*.jsonl.xz"))
MS = 1_000_000
#: What follows from how long something took.
OF_TIME = {
    "cycles",
    "latency_us",
    "margin_us",
    "tx_bytes",
    "rx_bytes",
    "uptime_ms",
    "bus_load",
    "tx_queue_bytes",
}


def test_every_kind_of_run_is_kept() -> None:
    assert len(KEPT) >= 19


def kept_journal(kept: Path, folder: Path) -> Journal:
    path = folder / "journal.jsonl"
    path.write_bytes(lzma.decompress(kept.read_bytes()))
    return read_journal(path)


def replayed_of(journal: Journal) -> list[JournalEntry]:
    refusals = refusals_of(journal)
    replayed: list[JournalEntry] = []

    def transmit(data: bytes, t_ns: int) -> int:
        if (t_ns, data) in refusals:
            return 0
        replayed.append(JournalEntry(t_ns, "tx", data))
        return len(data)

    feed(emulator_of(journal, "kept", transmit=transmit), journal)
    return replayed


def telemetry(journal: Journal, sent: Iterable[JournalEntry]) -> list[tuple[int, dict[str, Any]]]:
    """(time, packet) of what a unit has sent, by decoders of struct alone."""
    wiring, section = journal.header["can"], journal.header["unit"]["can"]
    if wiring is None:
        found, line = [], b""
        for entry in sent:
            line += entry.data
            whole = line.rfind(b"\xc0") + 1
            found += [(entry.t_ns, wire.decode_telemetry(frame)) for frame in wire.slip_frames(line[:whole])]
            line = line[max(whole - 1, 0) :]
        return found
    wide = section["identifier_bits"] == 29
    shift, node = 18 if wide else 0, wiring["node"] or section["node"]
    size = 64 if wiring["fd"] else 8
    peer = Peer((0x600 << shift) + node, (0x580 << shift) + node, wide, frame_bytes=size)
    for entry in sent:
        peer.take(entry.data, entry.t_ns)
    return [(t_ns, wire.decode_telemetry(packet)) for t_ns, packet in peer.packets]


def alike(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(
            name in OF_TIME or name.startswith("cycles") or alike(one[name], other[name]) for name in one
        )
    if isinstance(one, float):
        return one == pytest.approx(other, rel=1e-5, abs=1e-7)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(alike, one, other))
    return bool(one == other)


def assert_alike(journal: Journal, recorded: list[JournalEntry], replayed: list[JournalEntry]) -> None:
    ours, theirs = telemetry(journal, replayed), telemetry(journal, recorded)
    assert [packet["name"] for _, packet in ours] == [packet["name"] for _, packet in theirs]
    for (t_ns, packet), (other_ns, other) in zip(ours, theirs, strict=True):
        assert abs(t_ns - other_ns) < 5 * MS, packet["name"]
        if not packet["name"].startswith(("image_", "memory_")):
            assert alike(packet["fields"], other["fields"]), (packet, other)


@pytest.mark.parametrize("kept", KEPT, ids=lambda path: path.name.split(".")[0])
def test_the_same_octets_at_the_same_times(kept: Path, tmp_path: Path) -> None:
    journal = kept_journal(kept, tmp_path)
    replayed = replayed_of(journal)
    recorded = [entry for entry in journal.entries if entry.direction == "tx"]
    assert len(recorded) >= 5
    if rounds_as_recorded():
        assert first_difference(recorded, replayed) is None
    else:
        assert_alike(journal, recorded, replayed)


def test_the_comparison_by_content_sees_what_differs(tmp_path: Path) -> None:
    (kept,) = [path for path in KEPT if path.name.startswith("zy3-")]
    journal = kept_journal(kept, tmp_path)
    recorded = [entry for entry in journal.entries if entry.direction == "tx"]
    assert_alike(journal, recorded, recorded)
    later = [JournalEntry(entry.t_ns + 6 * MS, "tx", entry.data) for entry in recorded]
    with pytest.raises(AssertionError):
        assert_alike(journal, recorded, later)
    with pytest.raises(AssertionError):
        assert_alike(journal, recorded, recorded[:-40])
    assert not alike({"valid": 1}, {"valid": 0})
    assert not alike({"q_x": 0.1}, {"q_x": 0.1001})
    assert alike({"q_x": 0.1, "cycles": 5}, {"q_x": 0.1 + 1e-9, "cycles": 6})


if __name__ == "__main__":
    RECORDED.write_text(f"{numerics_digest()}  of the computer on which these journals were recorded\n")
    print(RECORDED.read_text(), file=sys.stderr)
