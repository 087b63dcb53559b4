"""Faults of the line, exercised."""

from __future__ import annotations

import struct
from itertools import pairwise

from hil_tests.faults.exercise import MS, Exercise, Seen
from hil_tests.unit.conftest import Bench
from hil_tests.vectors.received import EVENT
from hil_tests.vectors.reference_decoder import crc16

IN_3_S = 12  # attitude reports of 4 Hz


def octets(seen: Seen) -> bytes:
    """All that came on the line while the fault lasted."""
    return b"".join(
        group for t_ns, group in seen.bench.groups if seen.start_ms * MS <= t_ns <= seen.end_ms * MS
    )


def declared(frame: bytes) -> int:
    """The length of a packet by its own header."""
    return 7 + struct.unpack(">H", frame[4:6])[0]


def counts(seen: Seen, spare_ms: float = 0) -> list[int]:
    return [one.decoded["sequence_count"] for one in seen.between(0, seen.end_ms + spare_ms)]


def events(seen: Seen, name: str) -> list[dict[str, int]]:
    packets = [*seen.during(), *seen.after()]
    return [
        one.fields["data"]
        for one in packets
        if one.decoded["service"] == 5 and one.fields["event_id"] == EVENT[name]
    ]


# -- octets


def bits_flipped(seen: Seen) -> str:
    broken, whole = len(seen.broken), len(seen.during("attitude_report"))
    assert broken > 0
    assert whole < IN_3_S
    return f"{broken} frames with a wrong check sum or no packets, {whole} of {IN_3_S} attitude reports whole"


def bytes_lost(seen: Seen) -> str:
    short = [frame for frame in seen.broken if len(frame) < 6 or len(frame) < declared(frame)]
    whole = len(seen.during("attitude_report"))
    assert short
    assert whole < IN_3_S
    return f"{len(short)} frames shorter than they say, {whole} of {IN_3_S} attitude reports whole"


def longer(seen: Seen) -> str:
    long = [frame for frame in seen.broken if len(frame) >= 6 and len(frame) > declared(frame)]
    whole = len(seen.during("attitude_report"))
    assert long
    assert whole < IN_3_S
    return f"{len(long)} frames longer than they say, {whole} of {IN_3_S} attitude reports whole"


# -- messages


def frames_lost(seen: Seen) -> str:
    found = counts(seen, 1000)
    missing = found[-1] - found[0] + 1 - len(found)
    assert missing > 0
    assert not seen.broken
    return f"{missing} sequence counts missing, the rest whole"


def frames_doubled(seen: Seen) -> str:
    during = seen.during()
    twice = [one.decoded["sequence_count"] for one in during]
    assert twice[::2] == twice[1::2] == sorted(set(twice))
    assert [one.fields for one in during[::2]] == [one.fields for one in during[1::2]]
    assert len(seen.during("attitude_report")) == 2 * IN_3_S
    found = [one.decoded["sequence_count"] for one in seen.after()]
    assert found == list(range(found[0], found[0] + len(found)))
    return f"{len(twice) // 2} packets twice, with the same sequence count"


def frames_delayed(seen: Seen) -> str:
    def age_ms(one) -> float:
        seconds, fraction = one.decoded["time"]  # since power-on: the time was not set
        return one.t_ns / MS - 1000 * (seconds + fraction / (1 << 24))

    ages = [age_ms(one) for one in seen.during("attitude_report")]
    late = [age for age in ages if age > 100]
    assert late
    assert len(late) < len(ages)
    assert all(300 <= age < 350 for age in late)
    found = counts(seen, 1000)
    assert sorted(found) == list(range(found[0], found[-1] + 1))
    overtaken = sum(one > other for one, other in pairwise(found))
    assert overtaken
    assert all(age_ms(one) < 50 for one in seen.between(seen.end_ms + 50, seen.end_ms + 3000))
    return f"{len(late)} of {len(ages)} attitude reports 300 ms late, {overtaken} times overtaken by others"


def frames_reordered(seen: Seen) -> str:
    found = counts(seen, 1000)
    assert sorted(found) == list(range(found[0], found[-1] + 1))
    swapped = [(one, other) for one, other in pairwise(found) if one > other]
    assert swapped
    assert all(one == other + 1 for one, other in swapped)
    assert not seen.broken
    return f"{len(swapped)} pairs the wrong way round, no sequence count missing"


def frames_cut(seen: Seen) -> str:
    assert not seen.during()
    assert len(seen.broken) >= IN_3_S
    assert all(len(frame) < 6 or len(frame) < declared(frame) for frame in seen.broken)
    shortest, longest = min(map(len, seen.broken)), max(map(len, seen.broken))
    return (
        f"{len(seen.broken)} packets of {shortest} to {longest} octets, shorter than they say; no whole one"
    )


def wrong_crc(seen: Seen) -> str:
    assert not seen.during()
    assert len(seen.broken) >= IN_3_S
    for frame in seen.broken:
        assert len(frame) == declared(frame)
        assert crc16(frame) != 0
        assert frame[:2] == bytes((0x08 | seen.bench.apid >> 8, seen.bench.apid & 0xFF))
    return f"{len(seen.broken)} packets of the right length with a wrong check sum, no good one"


def pings(bench: Bench, seen: Seen) -> None:
    """A ping each 200 ms while the fault lasts."""
    seen.figures["pings"] = 0
    while bench.now_ms < seen.end_ms - 200:
        bench.send("ping")
        seen.figures["pings"] += 1
        bench.run(200)


def wrong_crc_to_the_unit(seen: Seen) -> str:
    sent = seen.figures["pings"]
    told = events(seen, "TC_CRC_FAILED")
    assert not seen.during("pong")
    assert not seen.broken
    assert len(told) >= 1
    assert told[-1]["count"] <= sent
    assert len(seen.during("attitude_report")) == IN_3_S
    return f"{sent} pings, none answered; {len(told)} times TC_CRC_FAILED; telemetry goes on"


def lost_to_the_unit(seen: Seen) -> str:
    sent, answered = seen.figures["pings"], len(seen.during("pong"))
    assert 0 < answered < sent
    gaps = len(events(seen, "TC_SEQUENCE_GAP_DETECTED"))
    assert gaps
    return f"{answered} of {sent} pings answered, {gaps} times TC_SEQUENCE_GAP_DETECTED"


# -- the signal


def line_break(seen: Seen) -> str:
    assert octets(seen) == b"\0"
    assert not seen.during()
    return "one octet 00, then nothing for 3 s"


def baud_error(seen: Seen) -> str:
    whole, found = len(seen.during()), len(octets(seen))
    assert whole == 0
    assert found > 100
    return f"{found} octets, no good packet"


def baud_error_within(seen: Seen) -> str:
    assert len(seen.during("attitude_report")) == IN_3_S
    assert not seen.broken
    found = counts(seen)
    assert found == list(range(found[0], found[-1] + 1))
    return f"all {IN_3_S} attitude reports whole: ten bits bear it"


def silence(seen: Seen) -> str:
    assert octets(seen) == b""
    before, after = seen.before()[-1], seen.after()[0]
    gap = after.decoded["sequence_count"] - before.decoded["sequence_count"] - 1
    assert gap >= IN_3_S
    return f"nothing for 3 s, then a gap of {gap} sequence counts"


def babble(seen: Seen) -> str:
    whole = len(seen.during("attitude_report"))
    assert len(seen.broken) > 0
    assert whole < IN_3_S
    found = len(octets(seen))
    assert found > 6000  # 2000 a second, beside the unit's own
    return (
        f"{found} octets, {len(seen.broken)} frames that are none, {whole} of {IN_3_S} attitude reports whole"
    )


def babble_to_the_unit(seen: Seen) -> str:
    malformed, crc = len(events(seen, "TC_MALFORMED")), len(events(seen, "TC_CRC_FAILED"))
    assert malformed + crc > 0
    assert not seen.broken
    assert len(seen.during("attitude_report")) == IN_3_S
    return f"{malformed} times TC_MALFORMED; telemetry goes on"


TO_UNIT = {"direction": "to_unit"}
ON_BOTH = (
    ({"kind": "line.frames_lost", "probability": 0.5}, frames_lost),
    ({"kind": "line.frames_doubled"}, frames_doubled),
    ({"kind": "line.frames_delayed", "probability": 0.4, "delay_ms": 300}, frames_delayed),
    ({"kind": "line.frames_reordered", "probability": 0.5}, frames_reordered),
    ({"kind": "line.frames_cut"}, frames_cut),
    ({"kind": "line.wrong_crc"}, wrong_crc),
)

EXERCISES = (
    Exercise({"kind": "line.bits_flipped", "probability": 0.01}, bits_flipped),
    Exercise({"kind": "line.bytes_lost", "probability": 0.01}, bytes_lost),
    Exercise({"kind": "line.bytes_doubled", "probability": 0.01}, longer),
    Exercise({"kind": "line.bytes_inserted", "probability": 0.01}, longer),
    *(Exercise(fault, judged, on_can=on_can) for fault, judged in ON_BOTH for on_can in (False, True)),
    *(
        Exercise(fault | TO_UNIT, judged, name="to the unit", on_can=on_can, meanwhile=pings)
        for fault, judged in (
            ({"kind": "line.wrong_crc"}, wrong_crc_to_the_unit),
            ({"kind": "line.frames_lost", "probability": 0.5}, lost_to_the_unit),
        )
        for on_can in (False, True)
    ),
    Exercise({"kind": "line.break"}, line_break),
    Exercise({"kind": "line.baud_error", "percent": 6}, baud_error),
    Exercise({"kind": "line.baud_error", "percent": 100}, baud_error, name="at twice the rate"),
    Exercise({"kind": "line.baud_error", "percent": -5}, baud_error_within, name="of 5 %"),
    Exercise({"kind": "line.silence"}, silence),
    Exercise({"kind": "line.babble", "octets_per_s": 2000}, babble),
    Exercise({"kind": "line.babble", "octets_per_s": 2000} | TO_UNIT, babble_to_the_unit, name="to the unit"),
)
