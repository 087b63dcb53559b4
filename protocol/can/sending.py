"""The sending half of an ISO-TP connection: one PDU at a time, cut into frames (ISO 15765-2:2016)."""

from __future__ import annotations

from .frames import CLASSIC_BYTES, CanFrame
from .transfer import (
    CONSECUTIVE,
    CONTINUE_TO_SEND,
    FIRST,
    MAX_SHORT_FIRST_FRAME_BYTES,
    NEVER_NS,
    OVERFLOW,
    WAIT,
    FrameIgnored,
    FrameWriter,
    IsoTpCounters,
    IsoTpSettings,
    PduSent,
    TransmissionFailed,
    decode_separation_time_ns,
)
from .vocabulary import TransferFailure

_LONGEST_SEPARATION_NS = 127_000_000
_SEQUENCES = [bytes([CONSECUTIVE << 4 | number]) for number in range(16)]


class PduSender:
    """``deadline_ns`` is the end of the timer that runs (N_As or N_Bs), ``ready_ns`` the time from which the
    next frame may be handed over, each NEVER_NS where there is none. ``handed_over`` is the frame whose
    confirmation is awaited.
    """

    def __init__(self, settings: IsoTpSettings, counters: IsoTpCounters) -> None:
        self._settings = settings
        self._counters = counters
        self._writer = FrameWriter(settings)
        # 9.6.2.1: in frames above 8 bytes a second byte has the length.
        long_frames = settings.frame_bytes > CLASSIC_BYTES
        self._longest_single_bytes = settings.frame_bytes - (2 if long_frames else 1)
        self._consecutive_bytes = settings.frame_bytes - 1
        self.clear()

    def clear(self) -> None:
        """Forget the PDU under way."""
        self.deadline_ns = NEVER_NS
        self.ready_ns = NEVER_NS
        self.handed_over: CanFrame | None = None
        self._data = b""  # never empty while a PDU is under way
        self._offset = 0  # of the first byte that was not yet handed over
        self._sequence = 0
        self._awaits_flow_control = False
        self._block_left = 0  # consecutive frames up to the next flow control; 0: no other comes
        self._waits = 0
        self._separation_ns = 0
        self._reserved_stmin = False
        self._first_is_over = False  # consecutive frames follow
        self._consecutive_sent_ns: int | None = None

    @property
    def sending(self) -> bool:
        return bool(self._data)

    def send(self, data: bytes, now_ns: int) -> None:
        self._data = data
        self.ready_ns = now_ns

    def next_frame(self, now_ns: int) -> CanFrame | None:
        if now_ns < self.ready_ns:
            return None
        frame = self._writer.frame(self._consecutive() if self._offset else self._begin())
        self.handed_over = frame
        self.ready_ns = NEVER_NS
        self.deadline_ns = now_ns + self._settings.n_as_ns
        return frame

    def _begin(self) -> bytes:
        """Single frame (9.6.2) or first frame (9.6.3)."""
        length = len(self._data)
        if length <= self._longest_single_bytes:
            self._offset = length
            return (bytes([length]) if length < CLASSIC_BYTES else bytes([0, length])) + self._data
        if length <= MAX_SHORT_FIRST_FRAME_BYTES:
            head = (FIRST << 12 | length).to_bytes(2, "big")
        else:
            head = bytes([FIRST << 4, 0]) + length.to_bytes(4, "big")
        self._offset = self._settings.frame_bytes - len(head)
        self._sequence = 1
        self._awaits_flow_control = True
        return head + self._data[: self._offset]

    def _consecutive(self) -> bytes:
        start = self._offset
        self._offset = end = start + self._consecutive_bytes
        head = _SEQUENCES[self._sequence]
        self._sequence = (self._sequence + 1) & 0xF
        if self._block_left:
            self._block_left -= 1
            self._awaits_flow_control = not self._block_left and end < len(self._data)
        return head + self._data[start:end]

    def confirmed(self, now_ns: int) -> PduSent | None:
        """The frame handed over has left."""
        self.handed_over = None
        if self._offset >= len(self._data):
            event = PduSent(len(self._data), now_ns)
            self.clear()
            return event
        if self._first_is_over:
            self._consecutive_sent_ns = now_ns
        self._first_is_over = True
        if self._awaits_flow_control:
            self.deadline_ns = now_ns + self._settings.n_bs_ns
        else:
            self._continue(now_ns)
        return None

    def flow_control(self, data: bytes, now_ns: int) -> TransmissionFailed | FrameIgnored | None:
        """A flow control frame, at least one byte (9.6.5).

        It may come before the confirmation of the frame that it answers: the other side has seen that frame,
        while our controller's word for it may still be on its way.
        """
        if len(data) < 3:
            return FrameIgnored(TransferFailure.BAD_LENGTH, now_ns)
        if not self._awaits_flow_control:
            return FrameIgnored(TransferFailure.UNEXPECTED_PDU, now_ns)
        status = data[0] & 0xF
        if status == CONTINUE_TO_SEND:
            self._awaits_flow_control = False
            self._waits = 0
            self._block_left = data[1]
            self._separate(data[2])
            if self.handed_over is None:
                self._continue(now_ns)
            return None
        if status == WAIT:
            self._counters.wait_frames_received += 1
            self._waits += 1
            if self._waits > self._settings.wait_frames_max:
                return self.fail(TransferFailure.WAIT_LIMIT, now_ns)
            if self.handed_over is None:
                self.deadline_ns = now_ns + self._settings.n_bs_ns
            return None
        if status == OVERFLOW:
            return self.fail(TransferFailure.RECEIVER_OVERFLOW, now_ns)
        return self.fail(TransferFailure.INVALID_FLOW_STATUS, now_ns)

    def _separate(self, stmin: int) -> None:
        """9.6.5.5: after a reserved STmin the longest holds up to the end of the PDU."""
        separation_ns = decode_separation_time_ns(stmin)
        self._reserved_stmin = self._reserved_stmin or separation_ns is None
        if self._reserved_stmin or separation_ns is None:
            separation_ns = _LONGEST_SEPARATION_NS
        self._separation_ns = separation_ns

    def _continue(self, now_ns: int) -> None:
        """STmin runs from one consecutive frame to the next, over flow control too (9.6.5.4)."""
        self.deadline_ns = NEVER_NS
        self.ready_ns = now_ns
        if self._consecutive_sent_ns is not None:
            self.ready_ns = max(now_ns, self._consecutive_sent_ns + self._separation_ns)

    def expire(self, now_ns: int) -> TransmissionFailed | None:
        if now_ns < self.deadline_ns:
            return None
        awaited = TransferFailure.TIMEOUT_BS if self.handed_over is None else TransferFailure.TIMEOUT_A
        return self.fail(awaited, self.deadline_ns)

    def fail(self, reason: TransferFailure, time_ns: int) -> TransmissionFailed:
        event = TransmissionFailed(reason, len(self._data), time_ns)
        self.clear()
        return event
