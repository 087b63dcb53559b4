"""Faults of the CAN bus, exercised."""

from __future__ import annotations

from hil_tests.faults.exercise import MS, Exercise, Seen
from hil_tests.faults.exercises_line import IN_3_S, events
from hil_tests.unit.conftest import CanBench
from hil_tests.vectors.reference_can import records

BABBLE = 0x001
TIMEOUT_A, TIMEOUT_BS = 1, 2
RECOVERY_BITS = 128 * 11


def of_the_unit(seen: Seen) -> list[int]:
    """Identifiers of all frames that came while the fault lasted, without those of the babbling node."""
    return [
        identifier
        for t_ns, group in seen.bench.groups
        if seen.start_ms * MS < t_ns <= seen.end_ms * MS
        for identifier, _ in records(group)
        if identifier != BABBLE
    ]


def cyclic(seen: Seen, name: str = "status", start_ms: float = 0, end_ms: float = 0) -> list[int]:
    """Counters of the frames of a kind while the fault lasted."""
    assert isinstance(seen.bench, CanBench)
    start_ns = (start_ms or seen.start_ms) * MS
    end_ns = (end_ms or seen.end_ms) * MS
    return [fields["counter"] for t_ns, fields in seen.bench.frames(name) if start_ns < t_ns <= end_ns]


def lost_packets(seen: Seen, reason: int) -> int:
    told = events(seen, "CAN_PACKETS_LOST")
    assert told
    assert {one["reason"] for one in told} == {reason}
    return sum(one["packets"] for one in told)


def some_errors(seen: Seen) -> str:
    assert cyclic(seen) == list(range(cyclic(seen)[0], cyclic(seen)[0] + IN_3_S))
    assert len(seen.during("attitude_report")) == IN_3_S
    assert isinstance(seen.bench, CanBench)
    errors = seen.bench.can()["error_frames"]
    assert errors > 10
    return f"every frame and packet comes; the unit's counters tell {errors} error frames"


def all_errors(seen: Seen) -> str:
    assert of_the_unit(seen) == []
    back = events(seen, "CAN_BUS_OFF_RECOVERED")
    counts = [one["count"] for one in back]
    assert counts == sorted(counts)
    assert counts[-1] > 10
    assert all(101 <= one["duration_ms"] <= 102 for one in back)
    assert events(seen, "CAN_ERROR_PASSIVE_ENTERED")
    return f"nothing for 3 s; afterwards {counts[-1]} times bus-off, each for 101 ms (its restart time)"


def bus_off(seen: Seen) -> str:
    assert of_the_unit(seen) == []
    (back,) = events(seen, "CAN_BUS_OFF_RECOVERED")
    assert 3000 <= back["duration_ms"] <= 3000 + 2 * RECOVERY_BITS / 1000 + 1
    lost = lost_packets(seen, TIMEOUT_A)
    return f"nothing for 3 s, then bus-off for {back['duration_ms']} ms told once, {lost} packets lost"


def no_acknowledge(seen: Seen) -> str:
    assert of_the_unit(seen) == []
    assert not events(seen, "CAN_BUS_OFF_RECOVERED")
    lost = lost_packets(seen, TIMEOUT_A)
    assert isinstance(seen.bench, CanBench)
    told = seen.bench.can()
    assert told["bus_off_count"] == 0
    assert told["error_frames"] > 10_000  # an attempt after the other
    return f"nothing for 3 s, {told['error_frames']} attempts, never bus-off; {lost} packets lost"


def stuck_dominant(seen: Seen) -> str:
    assert of_the_unit(seen) == []
    (back,) = events(seen, "CAN_BUS_OFF_RECOVERED")
    assert 2000 < back["duration_ms"] <= 3000 + 2 * RECOVERY_BITS / 1000
    lost = lost_packets(seen, TIMEOUT_A)
    return f"nothing for 3 s, then bus-off for {back['duration_ms']} ms told once, {lost} packets lost"


def babble_of_others(seen: Seen) -> int:
    return sum(
        identifier == BABBLE
        for t_ns, group in seen.bench.groups
        if seen.start_ms * MS < t_ns <= seen.end_ms * MS
        for identifier, _ in records(group)
    )


def babbling_node(seen: Seen) -> str:
    babble = babble_of_others(seen)
    assert 5995 <= babble <= 6001  # 2000 a second
    assert len(seen.during("attitude_report")) == IN_3_S
    assert isinstance(seen.bench, CanBench)
    lost = seen.bench.can()["arbitration_lost"]
    assert lost > 0
    return f"{babble} frames of the other node; all {IN_3_S} attitude reports, arbitration lost {lost} times"


def full_bus(seen: Seen) -> str:
    babble = babble_of_others(seen)
    assert of_the_unit(seen) == []
    assert babble > 3 * 1_000_000 / 135  # the longest of its frames, one behind the other
    lost = lost_packets(seen, TIMEOUT_A)
    after = [t_ns for t_ns, _ in seen.bench.groups if t_ns > (seen.end_ms + 1) * MS]
    assert after
    assert BABBLE not in {
        identifier
        for t_ns, group in seen.bench.groups
        if t_ns > (seen.end_ms + 1) * MS
        for identifier, _ in records(group)
    }
    return f"{babble} frames of the other node and none of the unit; {lost} packets lost"


def frames_lost(seen: Seen) -> str:
    assert isinstance(seen.bench, CanBench)
    found = cyclic(seen)
    missing = IN_3_S - len(found)
    assert 0 < missing < IN_3_S
    whole = len(seen.during("attitude_report"))
    assert whole < IN_3_S
    return f"{missing} of {IN_3_S} status frames missing, {whole} of {IN_3_S} attitude reports whole"


def frames_delayed(seen: Seen) -> str:
    assert isinstance(seen.bench, CanBench)

    def places_ms(start_ms: float, end_ms: float) -> list[float]:
        """Of the status frames, behind the start of a frame period."""
        found = [t_ns / MS for t_ns, _ in seen.bench.frames("status")]
        return [t_ms % 250 for t_ms in found if start_ms < t_ms <= end_ms]

    usual = places_ms(2000, seen.start_ms)
    earliest, latest = min(usual) - 2, max(usual) + 2  # a frame takes as long as its stars need
    assert latest - earliest < 20
    during = places_ms(seen.start_ms, seen.end_ms)
    late = sum(earliest + 40 <= place <= latest + 40 for place in during)
    assert 0 < late < IN_3_S
    assert sum(earliest <= place <= latest for place in during) == IN_3_S - late
    assert all(earliest <= place <= latest for place in places_ms(seen.end_ms + 10, seen.end_ms + 3000))
    assert sorted(cyclic(seen)) == list(range(min(cyclic(seen)), min(cyclic(seen)) + IN_3_S))
    return f"{late} of {IN_3_S} status frames 40 ms late, none missing"


def no_flow_control(seen: Seen) -> str:
    assert isinstance(seen.bench, CanBench)
    telemetry = seen.bench.peer.telemetry
    kinds = [
        payload[0] >> 4
        for t_ns, group in seen.bench.groups
        if seen.start_ms * MS < t_ns <= seen.end_ms * MS
        for identifier, payload in records(group)
        if identifier == telemetry
    ]
    assert set(kinds) == {1}  # first frames alone
    assert len(kinds) <= 4  # one in each N_Bs of 1 s
    assert not seen.during()
    assert cyclic(seen) == list(range(cyclic(seen)[0], cyclic(seen)[0] + IN_3_S))
    lost = lost_packets(seen, TIMEOUT_BS)
    return f"{len(kinds)} first frames and no more of them, all cyclic frames; {lost} packets lost"


EXERCISES: tuple[Exercise, ...] = tuple(
    Exercise(fault, judged, name=name, on_can=True)
    for fault, judged, name in (
        ({"kind": "bus.error_frames", "probability": 0.1}, some_errors, "at one in ten"),
        ({"kind": "bus.error_frames"}, all_errors, "always"),
        ({"kind": "bus.bus_off"}, bus_off, ""),
        ({"kind": "bus.no_acknowledge"}, no_acknowledge, ""),
        ({"kind": "bus.babbling_node", "frames_per_s": 2000}, babbling_node, ""),
        ({"kind": "bus.babbling_node", "frames_per_s": 20000}, full_bus, "on a full bus"),
        ({"kind": "bus.frames_lost", "probability": 0.3}, frames_lost, ""),
        ({"kind": "bus.frames_delayed", "probability": 0.5, "delay_ms": 40}, frames_delayed, ""),
        ({"kind": "bus.stuck_dominant"}, stuck_dominant, ""),
        ({"kind": "bus.no_flow_control"}, no_flow_control, ""),
    )
)
