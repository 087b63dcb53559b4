"""What both directions of an ISO-TP connection share (ISO 15765-2:2016): settings, events, counters, and how
the content of an N_PDU becomes a CAN frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..durations import NS_PER_US
from ..errors import LocalProtocolError
from .frames import (
    CAN_FD_LENGTHS,
    CLASSIC_BYTES,
    MAX_EXTENDED_IDENTIFIER,
    MAX_STANDARD_IDENTIFIER,
    CanFrame,
    padded_length,
)
from .vocabulary import TransferFailure

NEVER_NS = 1 << 63  # later than any time
MAX_PDU_BYTES = (1 << 32) - 1  # FF_DL has 32 bits behind its escape (9.6.3.1)
MAX_SHORT_FIRST_FRAME_BYTES = 4095  # FF_DL without escape has 12 bits
MAX_BLOCK_SIZE = 255
MAX_SEPARATION_TIME_US = 127_000
FRAME_BYTES = CAN_FD_LENGTHS[CAN_FD_LENGTHS.index(CLASSIC_BYTES) :]  # of TX_DL and RX_DL (9.5.1)

# High nibble of the first byte (9.6.1, table 9)
SINGLE, FIRST, CONSECUTIVE, FLOW_CONTROL = range(4)
# FlowStatus (9.6.5.1, table 18)
CONTINUE_TO_SEND, WAIT, OVERFLOW = range(3)

_US_PER_MS = 1_000
_LONGEST_STMIN = 0x7F


def frame_kind(data: bytes) -> int | None:
    """SINGLE, FIRST, CONSECUTIVE, FLOW_CONTROL or a reserved number (9.6.1); None: no data."""
    return data[0] >> 4 if data else None


def payload_bytes(data: bytes) -> int:
    """Octets of a segmented PDU that a frame of ours carries, padding included; 0 for flow control.

    ASSUMED: the PDU has less than 4096 octets (no escape in the first frame).
    """
    kind = frame_kind(data)
    if kind is None or kind == FLOW_CONTROL:
        return 0
    return len(data) - (2 if kind == FIRST else 1)


def single_frame_bytes(frame_bytes: int, fd: bool) -> int:
    """The longest PDU that is a single frame, which no flow control answers (9.6.2)."""
    return frame_bytes - (2 if fd else 1)


def encode_separation_time(separation_time_us: int) -> int:
    """STmin of a flow control frame (9.6.5.4): 0 to 127 ms in milliseconds or 100 to 900 us in steps of 100.

    Raises:
        LocalProtocolError: STmin cannot say this time.
    """
    milliseconds, rest_us = divmod(separation_time_us, _US_PER_MS)
    if not rest_us and 0 <= milliseconds <= _LONGEST_STMIN:
        return milliseconds
    if not milliseconds and not rest_us % 100:
        return 0xF0 + rest_us // 100
    allowed = "0 to 127000 in steps of 1000, or 100 to 900 in steps of 100"
    raise LocalProtocolError("IsoTpSettings", "separation_time_us", separation_time_us, allowed)


def decode_separation_time_ns(stmin: int) -> int | None:
    """The time that STmin says; None: a reserved value (9.6.5.4)."""
    if stmin <= _LONGEST_STMIN:
        return stmin * _US_PER_MS * NS_PER_US
    if 0xF1 <= stmin <= 0xF9:
        return (stmin - 0xF0) * 100 * NS_PER_US
    return None


@dataclass(frozen=True, slots=True)
class IsoTpSettings:
    """One end of a connection with normal addressing: the two identifiers are all its address.

    ``extended``: both identifiers have 29 bits. ``frame_bytes`` is TX_DL, the length of our longest frames:
    8, with ``fd`` also 12 to 64. ``padding`` fills frames to 8 bytes, None leaves them as short as their
    content; CAN FD frames above 8 bytes are always filled to a length that exists, with 0xCC without a
    ``padding`` of their own. 0xCC is the value of 10.4.2: few stuff bits, few edges.

    ``block_size`` and ``separation_time_us`` are what our flow control asks the other side for: consecutive
    frames up to the next flow control (0: no other), and the time between two. ``max_receive_bytes`` bounds
    a PDU that is received, and with it the memory.

    ``n_as_ns`` is N_As and N_Ar, how long a frame handed to the controller may take to leave; ``n_bs_ns`` how
    long the other side may take to send flow control; ``n_cr_ns`` the same for a consecutive frame (9.8.1,
    table 16: 1000 ms each). ``wait_frames_max`` is how many times in a row the other side may answer WAIT.
    ASSUMED: ISO bounds only the receiver that sends them (N_WFTmax, 9.7); here no peer holds a sender for
    ever.

    Raises:
        LocalProtocolError: a value that the protocol does not have.
    """

    transmit_identifier: int
    receive_identifier: int
    extended: bool = False
    fd: bool = False
    frame_bytes: int = CLASSIC_BYTES
    bit_rate_switch: bool = True
    padding: int | None = 0xCC
    block_size: int = 0
    separation_time_us: int = 0
    max_receive_bytes: int = MAX_SHORT_FIRST_FRAME_BYTES
    n_as_ns: int = 1_000_000_000
    n_bs_ns: int = 1_000_000_000
    n_cr_ns: int = 1_000_000_000
    wait_frames_max: int = 10

    def __post_init__(self) -> None:
        highest = MAX_EXTENDED_IDENTIFIER if self.extended else MAX_STANDARD_IDENTIFIER
        self._demand("transmit_identifier", 0, highest)
        self._demand("receive_identifier", 0, highest)
        if self.transmit_identifier == self.receive_identifier:
            allowed = "another one than transmit_identifier"
            raise LocalProtocolError("IsoTpSettings", "receive_identifier", self.receive_identifier, allowed)
        lengths = FRAME_BYTES if self.fd else FRAME_BYTES[:1]
        if self.frame_bytes not in lengths:
            raise LocalProtocolError(
                "IsoTpSettings", "frame_bytes", self.frame_bytes, ", ".join(map(str, lengths))
            )
        if self.padding is not None:
            self._demand("padding", 0, 255)
        self._demand("block_size", 0, MAX_BLOCK_SIZE)
        encode_separation_time(self.separation_time_us)
        self._demand("max_receive_bytes", 1, MAX_PDU_BYTES)
        for name in ("n_as_ns", "n_bs_ns", "n_cr_ns"):
            self._demand(name, 1, NEVER_NS // 2)
        self._demand("wait_frames_max", 0, 255)

    def _demand(self, name: str, lowest: int, highest: int) -> None:
        value = getattr(self, name)
        if not lowest <= value <= highest:
            raise LocalProtocolError("IsoTpSettings", name, value, f"{lowest} to {highest}")


@dataclass(frozen=True, slots=True)
class PduReceived:
    """A PDU, whole; ``time_ns`` is when its last frame came."""

    data: bytes
    time_ns: int


@dataclass(frozen=True, slots=True)
class PduSent:
    """Our PDU of ``length`` bytes has left; ``time_ns`` is when its last frame was confirmed."""

    length: int
    time_ns: int


@dataclass(frozen=True, slots=True)
class ReceptionFailed:
    """A PDU that had begun will not come; ``length`` is the one that it announced, ``time_ns`` when this was
    certain (of a timeout: the end of the timer).
    """

    reason: TransferFailure
    length: int
    time_ns: int


@dataclass(frozen=True, slots=True)
class TransmissionFailed:
    """Our PDU of ``length`` bytes was given up; ``time_ns`` as in :class:`ReceptionFailed`."""

    reason: TransferFailure
    length: int
    time_ns: int


@dataclass(frozen=True, slots=True)
class FrameIgnored:
    """A frame of our identifier that changed nothing."""

    reason: TransferFailure
    time_ns: int


IsoTpEvent = PduReceived | PduSent | ReceptionFailed | TransmissionFailed | FrameIgnored


def _no_failures() -> dict[TransferFailure, int]:
    return dict.fromkeys(TransferFailure, 0)


@dataclass(slots=True)
class IsoTpCounters:
    """Since the connection was made; ``by_reason`` counts failures and ignored frames together."""

    pdus_received: int = 0
    pdus_sent: int = 0
    receptions_failed: int = 0
    transmissions_failed: int = 0
    frames_ignored: int = 0
    flow_controls_sent: int = 0
    wait_frames_received: int = 0
    by_reason: dict[TransferFailure, int] = field(default_factory=_no_failures)

    def count(self, event: IsoTpEvent) -> None:
        if isinstance(event, PduReceived):
            self.pdus_received += 1
            return
        if isinstance(event, PduSent):
            self.pdus_sent += 1
            return
        if isinstance(event, ReceptionFailed):
            self.receptions_failed += 1
        elif isinstance(event, TransmissionFailed):
            self.transmissions_failed += 1
        else:
            self.frames_ignored += 1
        self.by_reason[event.reason] += 1


class FrameWriter:
    """Content of an N_PDU to the CAN frame that carries it, filled as the settings say (10.4.2)."""

    def __init__(self, settings: IsoTpSettings) -> None:
        self._identifier = settings.transmit_identifier
        self._extended = settings.extended
        self._fd = settings.fd
        self._bit_rate_switch = settings.fd and settings.bit_rate_switch
        shortest = 0 if settings.padding is None else CLASSIC_BYTES
        lengths = (max(padded_length(length), shortest) for length in range(settings.frame_bytes + 1))
        filler = bytes([0xCC if settings.padding is None else settings.padding])
        self._padding = [filler * (length - content) for content, length in enumerate(lengths)]

    def frame(self, content: bytes) -> CanFrame:
        """``content`` has at most TX_DL bytes."""
        return CanFrame(
            self._identifier,
            content + self._padding[len(content)],
            self._extended,
            self._fd,
            self._bit_rate_switch,
        )
