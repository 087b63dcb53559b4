"""Error counters of the CAN controller against the rules of the specification, and what its driver says."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.pus.enumerations import CanState
from st_emulator.wire.can.controller import BusError, FaultConfinement, failed_attempt_ns

ACTIVE, PASSIVE, OFF = CanState.ERROR_ACTIVE, CanState.ERROR_PASSIVE, CanState.BUS_OFF
COUNTED_ERRORS = [error for error in BusError if error is not BusError.STUFF]


def counts(faults: FaultConfinement) -> tuple[int, int, CanState]:
    return faults.transmit_error_count, faults.receive_error_count, faults.state


@pytest.mark.parametrize("error", [BusError.BIT, BusError.FORM, BusError.CRC])
def test_sixteen_failures_make_passive_and_thirty_two_bus_off(error: BusError) -> None:
    faults = FaultConfinement()
    states = []
    for _ in range(32):
        faults.transmission_failed(error)
        states.append(faults.state)
    assert states == [ACTIVE] * 15 + [PASSIVE] * 16 + [OFF]
    faults.reset()
    assert counts(faults) == (0, 0, ACTIVE)


def test_a_node_alone_on_the_bus_never_goes_off() -> None:
    faults = FaultConfinement()
    for _ in range(1000):
        faults.transmission_failed(BusError.ACK)
    assert counts(faults) == (128, 0, PASSIVE)
    faults.transmission_failed(BusError.BIT)  # any other error counts as ever
    assert counts(faults) == (136, 0, PASSIVE)


def test_a_receiver_alone_can_be_passive_and_still_lacks_the_acknowledgement() -> None:
    faults = FaultConfinement()
    for _ in range(128):
        faults.reception_failed()
    faults.transmission_failed(BusError.ACK)
    assert counts(faults) == (0, 128, PASSIVE)


def test_stuff_errors_in_arbitration_do_not_count() -> None:
    faults = FaultConfinement()
    for _ in range(1000):
        faults.transmission_failed(BusError.STUFF)
    assert counts(faults) == (0, 0, ACTIVE)


def test_the_way_back() -> None:
    faults = FaultConfinement()
    for _ in range(300):
        faults.reception_failed()
    assert counts(faults) == (0, 255, PASSIVE)
    faults.reception_succeeded()
    assert faults.state is ACTIVE
    assert 119 <= faults.receive_error_count <= 127
    for _ in range(200):
        faults.reception_succeeded()
    assert faults.receive_error_count == 0
    for _ in range(20):
        faults.transmission_failed(BusError.FORM)
    for _ in range(32):
        assert faults.state is PASSIVE
        faults.transmission_succeeded()
    assert counts(faults) == (128, 0, PASSIVE)
    faults.transmission_succeeded()
    assert counts(faults) == (127, 0, ACTIVE)
    for _ in range(200):
        faults.transmission_succeeded()
    assert counts(faults) == (0, 0, ACTIVE)


STEPS = st.sampled_from(["sent", "received", "bad reception", *BusError])


@given(st.lists(STEPS, max_size=200), st.integers(0, 31), st.integers(0, 140))
def test_any_history_against_the_rules(steps: list, transmit_failures: int, receive_failures: int) -> None:
    """The rules of Bosch's CAN specification, 8, by their numbers, as plain arithmetic."""
    faults = FaultConfinement()
    for _ in range(transmit_failures):
        faults.transmission_failed(BusError.BIT)
    for _ in range(receive_failures):
        faults.reception_failed()
    transmit, receive, off = 8 * transmit_failures, receive_failures, False
    for step in steps:
        if off:
            break
        passive = transmit > 127 or receive > 127  # rule 9
        if step == "sent":
            faults.transmission_succeeded()
            transmit = max(transmit - 1, 0)  # rule 7
        elif step == "received":
            faults.reception_succeeded()
            receive = 127 if receive > 127 else max(receive - 1, 0)  # rule 8
        elif step == "bad reception":
            faults.reception_failed()
            receive = min(receive + 1, 255)  # rule 1
        else:
            faults.transmission_failed(step)
            exception_1 = step is BusError.ACK and passive
            exception_2 = step is BusError.STUFF
            transmit += 0 if exception_1 or exception_2 else 8  # rule 3
        off = transmit > 255  # rule 10
        passive = transmit > 127 or receive > 127  # rules 9, 11
        assert counts(faults) == (transmit, receive, OFF if off else PASSIVE if passive else ACTIVE)


# -- the time that a destroyed attempt takes, in bits of 1 us

BARE = CanFrame(0x5A5, b"\x55" * 8)  # 111 bits
LONG = CanFrame(0x5A5, b"\x55" * 64, fd=True, bit_rate_switch=True)  # 29 bits slow, 550 of 0.25 us
SIGNALLED_US = 12 + 8 + 3  # flags, delimiter, intermission


@pytest.mark.parametrize(
    ("error", "own", "sent_us", "long_us"),
    [
        # of the 12 bits of acknowledgement, end of frame and intermission: none, the slot, both
        (BusError.BIT, True, 111 - 12, 17 + 137.5),
        (BusError.BIT, False, 111 - 12, 17 + 137.5),
        (BusError.FORM, True, 111 - 12, 17 + 137.5),
        (BusError.STUFF, False, 111 - 12, 17 + 137.5),
        (BusError.ACK, True, 111 - 11, 18 + 137.5),
        (BusError.CRC, True, 111 - 10, 19 + 137.5),
        (BusError.STUFF, True, 1 + 11 + 1, 1 + 11 + 1),
    ],
)
def test_the_time_of_a_destroyed_attempt(error: BusError, own: bool, sent_us: float, long_us: float) -> None:
    for frame, before_us in ((BARE, sent_us), (LONG, long_us)):
        duration_ns = failed_attempt_ns(frame, error, own, 1_000_000, 4_000_000)
        assert duration_ns == (before_us + SIGNALLED_US) * 1000
    extended = CanFrame(0x15555555, extended=True)
    own_stuff_ns = failed_attempt_ns(extended, BusError.STUFF, True, 500_000, 500_000)
    assert own_stuff_ns == (1 + 11 + 1 + 1 + 18 + 1 + SIGNALLED_US) * 2000


# -- what the driver of a real controller says: classes and data of linux/can/error.h


def message(classes: int, **details: int) -> CanFrame:
    data = bytearray(8)
    for index, value in details.items():
        data[int(index.removeprefix("d"))] = value
    return CanFrame(classes, bytes(data), error=True)


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        ([message(0x004, d1=0x20)], (128, 0, PASSIVE)),  # TX_PASSIVE without counters
        ([message(0x004, d1=0x10)], (0, 128, PASSIVE)),  # RX_PASSIVE
        ([message(0x204, d1=0x20, d6=136, d7=3)], (136, 3, PASSIVE)),
        ([message(0x200, d6=255, d7=0)], (255, 0, PASSIVE)),  # the counters alone say it
        ([message(0x200, d6=10, d7=130)], (10, 130, PASSIVE)),
        ([message(0x204, d1=0x08, d6=96, d7=1)], (96, 1, ACTIVE)),  # TX_WARNING
        ([message(0x004, d1=0x08)], (96, 0, ACTIVE)),
        ([message(0x004, d1=0x04)], (0, 96, ACTIVE)),
        ([message(0x004, d1=0x20), message(0x004, d1=0x08)], (127, 0, ACTIVE)),  # back from passive
        ([message(0x004, d1=0x30), message(0x004, d1=0x40)], (95, 95, ACTIVE)),
        ([message(0x004, d1=0x30), message(0x204, d1=0x40, d6=0, d7=7)], (0, 7, ACTIVE)),
        ([message(0x040)], (256, 0, OFF)),
        ([message(0x240, d6=248, d7=2)], (256, 0, OFF)),
        ([message(0x040), message(0x200, d6=5, d7=5)], (256, 0, OFF)),  # eight bits cannot say 256
        ([message(0x040), message(0x100)], (0, 0, ACTIVE)),
        ([message(0x040), message(0x004, d1=0x40)], (0, 0, ACTIVE)),
        ([message(0x040), message(0x204, d1=0x20, d6=130, d7=0)], (130, 0, PASSIVE)),
        ([message(0x004, d1=0x20), message(0x100)], (0, 0, ACTIVE)),
        # Nothing of these is about the state: a bus error, a lost arbitration, an overflow.
        ([message(0x0A8, d2=0x80, d3=0x19, d6=99, d7=99)], (0, 0, ACTIVE)),
        ([message(0x002, d0=11)], (0, 0, ACTIVE)),
        ([message(0x004, d1=0x03)], (0, 0, ACTIVE)),
        ([message(0x040), message(0x004, d1=0x01)], (256, 0, OFF)),
        ([message(0x000, d1=0x20)], (0, 0, ACTIVE)),  # data[1] counts with its class only
    ],
)
def test_error_messages(messages: list[CanFrame], expected: tuple[int, int, CanState]) -> None:
    faults = FaultConfinement()
    for one in messages:
        faults.told(one)
    assert counts(faults) == expected


@given(
    st.lists(
        st.builds(CanFrame, st.integers(0, 0x3FF), st.binary(min_size=8, max_size=8), error=st.just(True))
    )
)
def test_state_and_counters_agree_whatever_is_told(messages: list[CanFrame]) -> None:
    faults = FaultConfinement()
    for one in messages:
        faults.told(one)
        transmit, receive, state = counts(faults)
        assert 0 <= receive <= 255
        assert (state is OFF) == (transmit > 255)
        assert (state is ACTIVE) == (transmit < 128 and receive < 128)
