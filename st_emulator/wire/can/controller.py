"""Fault confinement of a CAN controller: error counters and what follows from them, without any time.

The rules are those of ISO 11898-1:2015, 12.1.4 (Bosch, CAN Specification 2.0, part B, section 8).
"""

from __future__ import annotations

from enum import IntEnum

from ...protocol.can.bits import (
    ACKNOWLEDGE_BITS,
    END_OF_FRAME_BITS,
    ERROR_FRAME_BITS,
    INTERMISSION_BITS,
    bits_duration_ns,
    frame_duration_ns,
)
from ...protocol.can.frames import CanFrame
from ...protocol.can.vocabulary import CanState

WARNING_LIMIT = 96
PASSIVE_LIMIT = 128
BUS_OFF_LIMIT = 256
MOST_RECEIVE_ERRORS = 255  # ASSUMED: a register of eight bits; the standard sets no upper end
# ASSUMED: the upper end of the range of 119 to 127 that rule h allows.
RECEIVE_ERRORS_AFTER_SUCCESS = 127

# linux/can/error.h: error classes in the identifier, details in the data.
CLASS_LOST_ARBITRATION = 0x002
CLASS_CONTROLLER = 0x004
CLASS_BUS_OFF = 0x040
CLASS_RESTARTED = 0x100
CLASS_COUNTERS = 0x200
CONTROLLER_RX_OVERFLOW = 0x01
CONTROLLER_RX_WARNING = 0x04
CONTROLLER_TX_WARNING = 0x08
CONTROLLER_RX_PASSIVE = 0x10
CONTROLLER_TX_PASSIVE = 0x20
CONTROLLER_ACTIVE = 0x40
_WARNING = CONTROLLER_RX_WARNING | CONTROLLER_TX_WARNING
_PASSIVE = CONTROLLER_RX_PASSIVE | CONTROLLER_TX_PASSIVE
_ANY_STATE = _WARNING | _PASSIVE | CONTROLLER_ACTIVE

_ARBITRATION_BITS = 13  # SOF, 11-bit identifier, RTR
_EXTENDED_ARBITRATION_BITS = 33  # SOF, 11 bits, SRR, IDE, 18 bits, RTR


class BusError(IntEnum):
    """What ends an attempt to send a frame (ISO 11898-1, error detection)."""

    BIT = 1
    STUFF = 2
    FORM = 3
    CRC = 4
    ACK = 5


# Bits that a frame would still have had when the error flag starts. A missing acknowledgement is known at the
# end of its slot, a wrong CRC is flagged behind the acknowledge delimiter.
# ASSUMED: bit, stuff and form errors strike in the CRC delimiter, so that an attempt takes about the longest.
_BITS_CUT_OFF = {
    BusError.BIT: ACKNOWLEDGE_BITS + END_OF_FRAME_BITS + INTERMISSION_BITS,
    BusError.STUFF: ACKNOWLEDGE_BITS + END_OF_FRAME_BITS + INTERMISSION_BITS,
    BusError.FORM: ACKNOWLEDGE_BITS + END_OF_FRAME_BITS + INTERMISSION_BITS,
    BusError.CRC: END_OF_FRAME_BITS + INTERMISSION_BITS,
    BusError.ACK: 1 + END_OF_FRAME_BITS + INTERMISSION_BITS,
}


def failed_attempt_ns(frame: CanFrame, error: BusError, own: bool, bitrate: int, data_bitrate: int) -> int:
    """The time (ns) that an attempt ended by ``error`` occupies the bus: what there was of the frame, the
    error frame and the intermission. A sender sees stuff errors in arbitration only.
    """
    behind = ERROR_FRAME_BITS + INTERMISSION_BITS
    if own and error is BusError.STUFF:
        sent = _EXTENDED_ARBITRATION_BITS if frame.extended else _ARBITRATION_BITS
        return bits_duration_ns(sent + behind, bitrate)
    whole_ns = frame_duration_ns(frame, bitrate, data_bitrate)
    return whole_ns + bits_duration_ns(behind - _BITS_CUT_OFF[error], bitrate)


class FaultConfinement:
    """The transmit and the receive error counter of one controller, and its state."""

    def __init__(self) -> None:
        self.transmit_error_count = 0
        self.receive_error_count = 0
        self._bus_off = False

    @property
    def state(self) -> CanState:
        if self._bus_off:
            return CanState.BUS_OFF
        if self.transmit_error_count >= PASSIVE_LIMIT or self.receive_error_count >= PASSIVE_LIMIT:
            return CanState.ERROR_PASSIVE
        return CanState.ERROR_ACTIVE

    def reset(self) -> None:
        """A restart, or the end of bus-off (rule l)."""
        self.transmit_error_count = self.receive_error_count = 0
        self._bus_off = False

    def transmission_succeeded(self) -> None:
        """A frame of ours was acknowledged and its end was undisturbed (rule g)."""
        if self.transmit_error_count:
            self.transmit_error_count -= 1

    def reception_succeeded(self) -> None:
        """A frame of another node was received without an error up to its acknowledge slot (rule h)."""
        if self.receive_error_count >= PASSIVE_LIMIT:
            self.receive_error_count = RECEIVE_ERRORS_AFTER_SUCCESS
        elif self.receive_error_count:
            self.receive_error_count -= 1

    def transmission_failed(self, error: BusError) -> None:
        """``error`` ended a frame of ours: 8 more transmit errors (rule c) but for the rule's two exceptions.

        An error passive sender that lacks an acknowledgement is alone on the bus and stays out of bus-off. A
        stuff error is one in arbitration, of a recessive stuff bit: elsewhere a sender sees a bit error.
        """
        if error is BusError.STUFF:
            return
        if error is BusError.ACK and self.state is CanState.ERROR_PASSIVE:
            return
        self.transmit_error_count += 8
        if self.transmit_error_count >= BUS_OFF_LIMIT:
            self._bus_off = True

    def reception_failed(self) -> None:
        """An error was seen in a frame of another node: one more receive error (rule a).

        ASSUMED: every node sees it alike, so that no dominant bit follows our flag (rule b, 8 more).
        """
        self.receive_error_count = min(self.receive_error_count + 1, MOST_RECEIVE_ERRORS)

    def told(self, message: CanFrame) -> None:
        """An error message of SocketCAN: what the driver of a real controller says of it. The counters follow
        a state that comes without them, so that both always agree.
        """
        classes, data = message.identifier, message.data
        if classes & CLASS_BUS_OFF:
            self._bus_off = True
            self.transmit_error_count = max(self.transmit_error_count, BUS_OFF_LIMIT)
            return
        status = data[1] if classes & CLASS_CONTROLLER else 0
        if classes & CLASS_RESTARTED or (self._bus_off and status & _ANY_STATE):
            self.reset()
        if self._bus_off:
            return
        if classes & CLASS_COUNTERS:
            self.transmit_error_count, self.receive_error_count = data[6], data[7]
        if status & _ANY_STATE and not status & _PASSIVE:
            most = PASSIVE_LIMIT - 1 if status & _WARNING else WARNING_LIMIT - 1
            self.transmit_error_count = min(self.transmit_error_count, most)
            self.receive_error_count = min(self.receive_error_count, most)
        for bit, least in ((CONTROLLER_TX_WARNING, WARNING_LIMIT), (CONTROLLER_TX_PASSIVE, PASSIVE_LIMIT)):
            if status & bit:
                self.transmit_error_count = max(self.transmit_error_count, least)
        for bit, least in ((CONTROLLER_RX_WARNING, WARNING_LIMIT), (CONTROLLER_RX_PASSIVE, PASSIVE_LIMIT)):
            if status & bit:
                self.receive_error_count = max(self.receive_error_count, least)
