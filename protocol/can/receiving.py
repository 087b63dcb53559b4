"""The receiving half of an ISO-TP connection: frames in, PDUs and flow control out (ISO 15765-2:2016)."""

from __future__ import annotations

from itertools import pairwise

from .frames import CLASSIC_BYTES, CanFrame
from .transfer import (
    CONTINUE_TO_SEND,
    FLOW_CONTROL,
    FRAME_BYTES,
    MAX_SHORT_FIRST_FRAME_BYTES,
    NEVER_NS,
    OVERFLOW,
    FrameIgnored,
    FrameWriter,
    IsoTpCounters,
    IsoTpEvent,
    IsoTpSettings,
    PduReceived,
    ReceptionFailed,
    encode_separation_time,
)
from .vocabulary import TransferFailure

# SF_DL in frames above 8 bytes begins where the next shorter frame ends (9.6.2.1, table 13).
_SHORTEST_LONG_SINGLE = {length: max(shorter - 1, CLASSIC_BYTES) for shorter, length in pairwise(FRAME_BYTES)}


class PduReceiver:
    """``reception_deadline_ns`` is the end of N_Cr, ``flow_control_deadline_ns`` that of N_Ar, each NEVER_NS
    where it does not run. ``handed_over`` is the flow control whose confirmation is awaited.

    At most one flow control is handed over and not confirmed, so that no amount of first frames fills the
    queue of a controller that cannot send. While one waits for its hand-over no timer runs: N_Br is
    a demand on us that ISO gives no timeout (9.8.1).
    """

    def __init__(self, settings: IsoTpSettings, counters: IsoTpCounters) -> None:
        self._settings = settings
        self._counters = counters
        writer = FrameWriter(settings)
        stmin = encode_separation_time(settings.separation_time_us)
        self._clear_to_send, self._overflow = (
            writer.frame(bytes([FLOW_CONTROL << 4 | status, settings.block_size, stmin]))
            for status in (CONTINUE_TO_SEND, OVERFLOW)
        )
        self.clear()

    def clear(self) -> None:
        """Forget the reception and every flow control."""
        self.flow_control_deadline_ns = NEVER_NS
        self.handed_over: CanFrame | None = None
        self._end()

    def _end(self) -> None:
        self.reception_deadline_ns = NEVER_NS
        self._length = 0  # of the PDU that is received; 0: none
        self._data = bytearray()
        self._frame_bytes = 0  # RX_DL, the length of its first frame (9.5.4)
        self._sequence = 0
        self._block_left = 0
        self._flow_control: CanFrame | None = None  # to be handed over
        self._flow_control_since_ns = NEVER_NS
        self._handed_over_for_reception = False  # else the reception that it belonged to is over

    @property
    def ready_ns(self) -> int:
        """From when a flow control may be handed over."""
        return self._flow_control_since_ns if self.handed_over is None else NEVER_NS

    def next_frame(self, now_ns: int) -> CanFrame | None:
        frame = self._flow_control
        if frame is None or self.handed_over is not None:
            return None
        self.handed_over = frame
        self._handed_over_for_reception = bool(self._length)
        self.flow_control_deadline_ns = now_ns + self._settings.n_as_ns
        self._flow_control = None
        self._flow_control_since_ns = NEVER_NS
        return frame

    def confirmed(self, now_ns: int) -> None:
        """The flow control handed over has left."""
        self._counters.flow_controls_sent += 1
        self.handed_over = None
        self.flow_control_deadline_ns = NEVER_NS
        if self._handed_over_for_reception:
            self.reception_deadline_ns = now_ns + self._settings.n_cr_ns

    def _ask(self, flow_control: CanFrame, now_ns: int) -> None:
        self._flow_control = flow_control
        self._flow_control_since_ns = now_ns
        self._block_left = self._settings.block_size
        self.reception_deadline_ns = NEVER_NS

    def single(self, data: bytes, now_ns: int) -> list[IsoTpEvent]:
        """A single frame, at least one byte (9.6.2).

        ASSUMED: whether the other side fills its frames is not known here, so that of 9.6.2.2 only that
        SF_DL fits is demanded of frames up to 8 bytes.
        """
        can_dl = len(data)
        if can_dl <= CLASSIC_BYTES:
            start, length = 1, data[0] & 0xF
            right = 0 < length < can_dl
        else:
            start, length = 2, data[1]
            right = not data[0] & 0xF and _SHORTEST_LONG_SINGLE[can_dl] <= length <= can_dl - start
        if not right:
            return [FrameIgnored(TransferFailure.BAD_LENGTH, now_ns)]
        events = self._interrupt(now_ns)
        if length > self._settings.max_receive_bytes:
            events.append(ReceptionFailed(TransferFailure.TOO_LONG, length, now_ns))
        else:
            events.append(PduReceived(data[start : start + length], now_ns))
        return events

    def first(self, data: bytes, now_ns: int) -> list[IsoTpEvent]:
        """A first frame, at least one byte (9.6.3). One that 9.6.3.2 says to ignore ends no reception."""
        can_dl = len(data)
        if can_dl < CLASSIC_BYTES:
            return [FrameIgnored(TransferFailure.BAD_LENGTH, now_ns)]
        start, length = 2, (data[0] & 0xF) << 8 | data[1]
        least = CLASSIC_BYTES if can_dl == CLASSIC_BYTES else can_dl - 1  # table 14
        if not length:
            start, length = 6, int.from_bytes(data[2:6], "big")
            least = MAX_SHORT_FIRST_FRAME_BYTES + 1
        if length < least:
            return [FrameIgnored(TransferFailure.BAD_LENGTH, now_ns)]
        events = self._interrupt(now_ns)
        if length > self._settings.max_receive_bytes:
            self._ask(self._overflow, now_ns)
            events.append(ReceptionFailed(TransferFailure.TOO_LONG, length, now_ns))
            return events
        self._length = length
        self._data += data[start:]
        self._frame_bytes = can_dl
        self._sequence = 1
        self._ask(self._clear_to_send, now_ns)
        return events

    def consecutive(self, data: bytes, now_ns: int) -> list[IsoTpEvent]:
        """A consecutive frame, at least one byte (9.6.4).

        The length is looked at before the sequence number: a frame that is too short is ignored without any
        further action (10.4.3), and so is one longer than the first.
        """
        if not self._length:
            return [FrameIgnored(TransferFailure.UNEXPECTED_PDU, now_ns)]
        can_dl = len(data)
        missing = self._length - len(self._data)
        if can_dl != self._frame_bytes and not missing < can_dl < self._frame_bytes:
            return [FrameIgnored(TransferFailure.BAD_LENGTH, now_ns)]
        if data[0] & 0xF != self._sequence:
            return [self._fail(TransferFailure.WRONG_SEQUENCE, now_ns)]
        if missing < can_dl:
            self._data += data[1 : 1 + missing]
            event = PduReceived(bytes(self._data), now_ns)
            self._end()
            return [event]
        self._data += data[1:]
        self._sequence = (self._sequence + 1) & 0xF
        # It answers the flow control, whether or not our controller has already confirmed that one.
        self._handed_over_for_reception = False
        if self._block_left == 1:
            self._ask(self._clear_to_send, now_ns)
            return []
        self._block_left = max(self._block_left - 1, 0)
        if self._flow_control is None:
            self.reception_deadline_ns = now_ns + self._settings.n_cr_ns
        return []

    def expire(self, now_ns: int) -> list[IsoTpEvent]:
        events: list[IsoTpEvent] = []
        if now_ns >= self.flow_control_deadline_ns:
            ended_ns = self.flow_control_deadline_ns
            self.handed_over = None
            self.flow_control_deadline_ns = NEVER_NS
            if self._handed_over_for_reception:
                events.append(self._fail(TransferFailure.TIMEOUT_A, ended_ns))
        if now_ns >= self.reception_deadline_ns:
            events.append(self._fail(TransferFailure.TIMEOUT_CR, self.reception_deadline_ns))
        return events

    def _interrupt(self, now_ns: int) -> list[IsoTpEvent]:
        """9.8.3: a single or first frame ends the reception in progress."""
        return [self._fail(TransferFailure.UNEXPECTED_PDU, now_ns)] if self._length else []

    def _fail(self, reason: TransferFailure, time_ns: int) -> ReceptionFailed:
        event = ReceptionFailed(reason, self._length, time_ns)
        self._end()
        return event
