"""N_As, N_Ar, N_Bs and N_Cr of ISO-TP (ISO 15765-2, 9.8), and what is handed over when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from hil_tests.protocol.transport_bus import MS, S
from hil_tests.protocol.transport_end import (
    GO_ON,
    UNIT,
    VIN,
    VIN_FRAMES,
    End,
    failed,
    lost,
    receiving,
    sending,
)
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.can.transport import FrameIgnored, IsoTpEvent, PduReceived, PduSent
from st_emulator.protocol.pus.enumerations import TransferFailure as Why

N_AS, N_BS, N_CR = 2 * S, 3 * S, 5 * S
SLOW = replace(UNIT, n_as_ns=N_AS, n_bs_ns=N_BS, n_cr_ns=N_CR)
BLOCKS = replace(SLOW, block_size=1)
START = 10 * MS  # the timer begins here


def unexpected(time_ns: int) -> list[IsoTpEvent]:
    return [FrameIgnored(Why.UNEXPECTED_PDU, time_ns)]


def nothing(time_ns: int) -> list[IsoTpEvent]:
    return []


@dataclass
class Timer:
    """``begin`` gives an end whose timer runs from START; ``rescue`` is what it waits for; ``too_late`` what
    that is worth afterwards.
    """

    name: str
    length_ns: int
    begin: Callable[[], End]
    rescue: Callable[[End, int], list[IsoTpEvent]]
    failure: Callable[[int], list[IsoTpEvent]]
    too_late: Callable[[int], list[IsoTpEvent]]


def handed_over(data: bytes = VIN) -> End:
    end = sending(data, SLOW)
    assert end.hands_over(START)
    return end


def consecutive_handed_over() -> End:
    end = sending(VIN, SLOW)
    assert end.says(1)
    assert end.hears("30 00 00", 2) == []
    assert end.hands_over(START) == VIN_FRAMES[1]
    return end


def first_has_left() -> End:
    end = sending(VIN, SLOW)
    assert end.hands_over(1)
    assert end.leaves(START) == []
    return end


def block_has_left() -> End:
    end = sending(VIN, SLOW)
    assert end.says(1)
    assert end.hears("30 01 00", 2) == []
    assert end.hands_over(2) == VIN_FRAMES[1]
    assert end.leaves(START) == []
    return end


def told_to_wait() -> End:
    end = sending(VIN, SLOW)
    assert end.says(1)
    assert end.hears("31 00 00", 2) == []
    assert end.hears("31 00 00", START) == []
    return end


def told_to_wait_before_it_left() -> End:
    end = sending(VIN, SLOW)
    assert end.hands_over(1)
    assert end.hears("31 00 00", 2) == []
    assert end.leaves(START) == []
    return end


def flow_control_handed_over() -> End:
    end = End(SLOW)
    assert end.hears(VIN_FRAMES[0], 1) == []
    assert end.hands_over(START) == GO_ON
    return end


def flow_control_has_left() -> End:
    end = End(SLOW)
    assert end.hears(VIN_FRAMES[0], 1) == []
    assert end.hands_over(2) == GO_ON
    assert end.leaves(START) == []
    return end


def consecutive_came() -> End:
    end = receiving(SLOW)
    assert end.hears(VIN_FRAMES[1], START) == []
    return end


def consecutive_came_early() -> End:
    """Before our controller confirms the flow control that it answers."""
    end = End(SLOW)
    assert end.hears(VIN_FRAMES[0], 1) == []
    assert end.hands_over(2) == GO_ON
    assert end.hears(VIN_FRAMES[1], START) == []
    assert end.leaves(START + 1) == []
    return end


def second_flow_control_has_left() -> End:
    end = End(BLOCKS)
    assert end.hears(VIN_FRAMES[0], 1) == []
    assert end.says(2)
    assert end.hears(VIN_FRAMES[1], 3) == []
    assert end.hands_over(4)
    assert end.leaves(START) == []
    return end


def time_out(reason: Why, length: int = len(VIN)) -> Callable[[int], list[IsoTpEvent]]:
    return lambda time_ns: (lost if reason is Why.TIMEOUT_CR else failed)(reason, time_ns, length)


def flow_control(end: End, now_ns: int) -> list[IsoTpEvent]:
    return end.hears("30 00 00", now_ns)


def second(end: End, now_ns: int) -> list[IsoTpEvent]:
    return end.hears(VIN_FRAMES[1], now_ns)


def third(end: End, now_ns: int) -> list[IsoTpEvent]:
    return [event for event in end.hears(VIN_FRAMES[2], now_ns) if event != PduReceived(VIN, now_ns)]


def leaves(end: End, now_ns: int) -> list[IsoTpEvent]:
    return [event for event in end.leaves(now_ns) if event != PduSent(3, now_ns)]


A, BS, CR = time_out(Why.TIMEOUT_A), time_out(Why.TIMEOUT_BS), time_out(Why.TIMEOUT_CR)
TIMERS = [
    Timer("N_As, single", N_AS, lambda: handed_over(VIN[:3]), leaves, time_out(Why.TIMEOUT_A, 3), nothing),
    Timer("N_As, first", N_AS, handed_over, leaves, A, nothing),
    Timer("N_As, consecutive", N_AS, consecutive_handed_over, leaves, A, nothing),
    Timer("N_Bs, first", N_BS, first_has_left, flow_control, BS, unexpected),
    Timer("N_Bs, block", N_BS, block_has_left, flow_control, BS, unexpected),
    Timer("N_Bs, wait", N_BS, told_to_wait, flow_control, BS, unexpected),
    Timer("N_Bs, early wait", N_BS, told_to_wait_before_it_left, flow_control, BS, unexpected),
    Timer(
        "N_Ar", N_AS, flow_control_handed_over, leaves, lambda time_ns: lost(Why.TIMEOUT_A, time_ns), nothing
    ),
    Timer("N_Cr, flow control", N_CR, flow_control_has_left, second, CR, unexpected),
    Timer("N_Cr, consecutive", N_CR, consecutive_came, third, CR, unexpected),
    Timer("N_Cr, early consecutive", N_CR, consecutive_came_early, third, CR, unexpected),
    Timer("N_Cr, second flow control", N_CR, second_flow_control_has_left, third, CR, unexpected),
]
each_timer = pytest.mark.parametrize("timer", TIMERS, ids=lambda timer: timer.name)


@each_timer
@pytest.mark.parametrize("late_ns", [0, 1, 3600 * S])
def test_it_ends_the_transfer_once_with_its_own_time(timer: Timer, late_ns: int) -> None:
    end, over_ns = timer.begin(), START + timer.length_ns
    assert end.deadline_ns == over_ns
    assert end.poll(over_ns - 1) == []
    assert end.poll(over_ns + late_ns) == timer.failure(over_ns)
    assert end.poll(over_ns + late_ns) == []
    assert (end.deadline_ns, end.connection.unconfirmed, end.connection.sending) == (None, (), False)


@each_timer
def test_what_comes_in_time_counts_however_late_the_poll(timer: Timer) -> None:
    end, over_ns = timer.begin(), START + timer.length_ns
    assert timer.rescue(end, over_ns - 1) == []
    assert end.poll(over_ns + N_AS - 2) == []  # N_As is the shortest timer that may have followed


@each_timer
@pytest.mark.parametrize("late_ns", [0, 1, 3600 * S])
def test_what_comes_too_late_rescues_nothing(timer: Timer, late_ns: int) -> None:
    end, over_ns = timer.begin(), START + timer.length_ns
    now_ns = over_ns + late_ns
    assert timer.rescue(end, now_ns) == timer.failure(over_ns) + timer.too_late(now_ns)
    assert end.poll(now_ns) == []
    assert end.deadline_ns is None


@each_timer
def test_a_good_transfer_follows(timer: Timer) -> None:
    end = timer.begin()
    end.poll(100 * S)
    assert end.hears("03 01 02 03", 101 * S) == [PduReceived(b"\1\2\3", 101 * S)]
    end.connection.send(b"\4", 102 * S)
    assert end.says(102 * S) == "01 04 CC CC CC CC CC CC"
    assert end.events == [PduSent(1, 102 * S)]


def test_timers_of_both_directions_in_the_order_of_their_ends() -> None:
    for wait_ns, order in ((4 * S, ["R", "T"]), (1 * S, ["T", "R"])):
        end = receiving(SLOW)  # N_Cr ends at 5 s
        end.connection.send(VIN, wait_ns)
        end.says(wait_ns)  # N_Bs ends at 4 or 7 s
        events = end.poll(100 * S)
        assert [type(event).__name__[0] for event in events] == order
        assert sorted(event.time_ns for event in events) == sorted((5 * S, wait_ns + 3 * S))


def test_the_last_frame_stops_the_timer() -> None:
    end = receiving(SLOW)
    end.hears(VIN_FRAMES[1], 1)
    assert end.hears(VIN_FRAMES[2], 2) == [PduReceived(VIN, 2)]
    assert (end.deadline_ns, end.poll(100 * S)) == (None, [])


def test_no_timer_runs_while_flow_control_waits_for_its_hand_over() -> None:
    end = End(SLOW)
    assert end.deadline_ns is None
    end.hears(VIN_FRAMES[0], 7)
    assert end.deadline_ns == 7
    assert end.poll(100 * S) == []
    assert end.says(100 * S) == GO_ON
    assert end.deadline_ns == 100 * S + N_CR


def test_flow_control_may_come_before_the_confirmation() -> None:
    """It has overtaken our controller's word for the frame that it answers; nothing follows before that."""
    end = sending(bytes(6 + 3 * 7))
    end.hands_over(0)
    assert end.hears("30 02 00", 1) == []
    assert end.hands_over(1) is None
    end.leaves(2)
    assert [str(end.says(2))[:2], str(end.hands_over(3))[:2]] == ["21", "22"]
    assert end.hears("30 00 01", 4) == []
    assert (end.hands_over(4), end.leaves(5)) == (None, [])
    assert end.deadline_ns == 5 + 1 * MS
    assert str(end.says(5 + 1 * MS))[:2] == "23"
    assert end.events == [PduSent(27, 5 + 1 * MS)]


@pytest.mark.parametrize(
    ("status", "reason"), [("32", Why.RECEIVER_OVERFLOW), ("33", Why.INVALID_FLOW_STATUS)]
)
def test_it_may_also_end_the_transmission_then(status: str, reason: Why) -> None:
    end = sending()
    end.hands_over(0)
    old = end.frame
    assert end.connection.unconfirmed == (old,)
    assert end.hears(f"{status} 00 00", 1) == failed(reason, 1)
    assert end.connection.unconfirmed == ()
    end.connection.send(b"\1\2", 2)
    assert end.hands_over(2)
    assert end.connection.confirmed(old, 3) == []  # not the confirmation that is awaited
    assert end.leaves(4) == [PduSent(2, 4)]


def test_a_block_ended_early_does_not_wait_for_confirmations() -> None:
    """A sender that is answered before our controller confirms: one flow control each, in their order."""
    end = End(BLOCKS)
    end.hears("10 14" + "AA" * 6, 0)
    assert end.hands_over(0) is not None
    first = end.frame
    assert end.hears("21" + "AA" * 7, 1) == []
    assert end.hands_over(1) is None  # never two that are not confirmed
    assert end.connection.confirmed(first, 2) == []
    assert end.says(2) is not None
    assert end.hears("22" + "AA" * 7, 3) == [PduReceived(b"\xaa" * 20, 3)]
    assert end.deadline_ns is None


def test_no_flow_control_follows_when_all_has_come() -> None:
    """A sender that does not wait for it."""
    end = End()
    end.hears(VIN_FRAMES[0], 0)
    end.hears(VIN_FRAMES[1], 1)
    assert end.hears(VIN_FRAMES[2], 2) == [PduReceived(VIN, 2)]
    assert (end.hands_over(3), end.deadline_ns) == (None, None)


def test_first_frames_without_end_hand_over_one_flow_control() -> None:
    """On a bus that takes nothing from us; when it does, the newest reception goes on."""
    end = End(SLOW)
    handed = []
    for now_ns in range(1000):
        end.hears(VIN_FRAMES[0], now_ns)
        handed.append(end.hands_over(now_ns))
    assert [text for text in handed if text] == [GO_ON]
    assert end.connection.unconfirmed == (end.frame,)
    assert end.connection.counters.by_reason[Why.UNEXPECTED_PDU] == 999
    end.leaves(1000)
    assert end.says(1001) == GO_ON
    end.hears(VIN_FRAMES[1], 1002)
    assert end.hears(VIN_FRAMES[2], 1003) == [PduReceived(VIN, 1003)]


def test_flow_control_of_a_reception_that_is_over_fails_no_other() -> None:
    end = flow_control_handed_over()
    assert end.hears(VIN_FRAMES[0], START + 1) == lost(Why.UNEXPECTED_PDU, START + 1)
    assert end.deadline_ns == START + N_AS
    assert end.poll(START + N_AS) == []
    assert end.says(START + N_AS) == GO_ON
    end.hears(VIN_FRAMES[1], START + N_AS)
    assert end.hears(VIN_FRAMES[2], START + N_AS) == [PduReceived(VIN, START + N_AS)]


def test_strange_confirmations_change_nothing() -> None:
    end = sending()
    stranger = CanFrame(0x123, b"\1")
    assert end.connection.confirmed(stranger, 0) == []
    end.hands_over(0)
    assert end.connection.confirmed(stranger, 0) == []
    assert end.connection.unconfirmed == (end.frame,)
    copy = CanFrame(0x58A, bytes.fromhex(VIN_FRAMES[0]))
    assert end.connection.confirmed(copy, 1) == []  # as a link that echoes what it sent gives it
    assert end.connection.unconfirmed == ()
    assert end.deadline_ns == 1 + 1 * S
    assert end.leaves(2) == []  # only once
    assert end.deadline_ns == 1 + 1 * S


def test_abort_and_reset() -> None:
    end = receiving()
    end.connection.send(VIN, 0)
    end.hands_over(0)
    end.connection.abort_sending()
    assert end.connection.counters.transmissions_failed == 1
    assert end.connection.counters.by_reason[Why.ABORTED] == 1
    assert not end.connection.sending
    end.connection.abort_sending()
    assert end.connection.counters.transmissions_failed == 1
    assert end.hears(VIN_FRAMES[1], 1) == []  # the reception goes on
    end.connection.send(VIN, 2)
    end.hears("10 08" + "AA" * 6, 2)
    end.connection.reset()
    assert (end.deadline_ns, end.connection.sending, end.connection.unconfirmed) == (None, False, ())
    assert end.hands_over(3) is None
    assert end.hears("21" + "AA" * 2, 3) == unexpected(3)
    assert end.poll(100 * S) == []
    assert end.connection.counters.receptions_failed == 1  # before the reset; the reset itself is no failure
