"""Faults of the line, exercised."""

from __future__ import annotations

from hil_tests.faults.exercise import Exercise, Seen


def bits_flipped(seen: Seen) -> str:
    broken, whole = len(seen.broken), len(seen.during("attitude_report"))
    assert broken > 0
    assert whole < 12  # of the twelve frames of 3 s
    return f"{broken} frames with a wrong check sum or no packets, {whole} of 12 attitude reports whole"


def frames_lost(seen: Seen) -> str:
    counts = [one.decoded["sequence_count"] for one in seen.sent if one.t_ns < (seen.end_ms + 1000) * 1e6]
    missing = counts[-1] - counts[0] + 1 - len(counts)
    assert missing > 0
    assert not seen.broken
    return f"{missing} sequence counts missing, the rest whole"


EXERCISES = (
    Exercise({"kind": "line.bits_flipped", "probability": 0.01}, bits_flipped),
    Exercise({"kind": "line.frames_lost", "probability": 0.5}, frames_lost),
    Exercise({"kind": "line.frames_lost", "probability": 0.5}, frames_lost, on_can=True),
)
