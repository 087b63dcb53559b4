"""Numbers with a name that belong to the CAN bus and its transport."""

from __future__ import annotations

from enum import Enum, IntEnum

__all__ = ["CAN_MEANINGS", "CanState", "TransferFailure"]


class CanState(IntEnum):
    """State of the unit's CAN controller (ISO 11898-1, fault confinement)."""

    ERROR_ACTIVE = 0
    ERROR_PASSIVE = 1
    BUS_OFF = 2
    NOT_USED = 3


class TransferFailure(IntEnum):
    """Why a transfer by ISO-TP (ISO 15765-2) failed, or a frame of it was ignored."""

    TIMEOUT_A = 1
    TIMEOUT_BS = 2
    TIMEOUT_CR = 3
    WRONG_SEQUENCE = 4
    UNEXPECTED_PDU = 5
    INVALID_FLOW_STATUS = 6
    WAIT_LIMIT = 7
    RECEIVER_OVERFLOW = 8
    TOO_LONG = 9
    BAD_LENGTH = 10
    BAD_PCI = 11
    ABORTED = 12


CAN_MEANINGS: tuple[tuple[Enum, str], ...] = (
    (CanState.ERROR_ACTIVE, "takes part in everything on the bus"),
    (CanState.ERROR_PASSIVE, "an error counter is above 127: it no longer stops the frames of others"),
    (CanState.BUS_OFF, "the transmit error counter is above 255: it sends and receives nothing"),
    (CanState.NOT_USED, "the unit is on its serial line, or off"),
    (TransferFailure.TIMEOUT_A, "N_As or N_Ar: the controller did not get the frame onto the bus"),
    (TransferFailure.TIMEOUT_BS, "N_Bs: no flow control came"),
    (TransferFailure.TIMEOUT_CR, "N_Cr: no consecutive frame came"),
    (TransferFailure.WRONG_SEQUENCE, "sequence number of a consecutive frame is not the next one"),
    (TransferFailure.UNEXPECTED_PDU, "a frame that does not belong to what is under way"),
    (TransferFailure.INVALID_FLOW_STATUS, "flow control with a reserved flow status"),
    (TransferFailure.WAIT_LIMIT, "more flow control frames WAIT than allowed"),
    (TransferFailure.RECEIVER_OVERFLOW, "flow control OVFLW: the receiver has no room for the packet"),
    (TransferFailure.TOO_LONG, "first frame of more bytes than the receive buffer has"),
    (TransferFailure.BAD_LENGTH, "a length that the frame cannot have"),
    (TransferFailure.BAD_PCI, "reserved protocol control information"),
    (TransferFailure.ABORTED, "given up by a reset"),
)
