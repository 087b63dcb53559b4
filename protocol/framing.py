"""SLIP framing (RFC 1055): a byte stream to frames and back.

END both opens and closes a frame (the RFC's recommendation against line noise), so that whatever stands
before the first END is a frame of its own and is rejected later by the packet parser.
"""

from __future__ import annotations

from dataclasses import dataclass

from .errors import LocalProtocolError
from .pus.enumerations import FramingReason

END = 0xC0
ESC = 0xDB
ESC_END = 0xDC
ESC_ESC = 0xDD

_END_BYTE = bytes([END])
_ESC_BYTE = bytes([ESC])
_ESCAPED_END = bytes([ESC, ESC_END])
_ESCAPED_ESC = bytes([ESC, ESC_ESC])


@dataclass(frozen=True, slots=True)
class FrameReceived:
    """A frame, its escapes undone; ``time_ns`` is when its closing END came."""

    data: bytes
    time_ns: int


@dataclass(frozen=True, slots=True)
class FrameDiscarded:
    """A frame thrown away whole; ``length`` is the number of its bytes on the line, without the ENDs."""

    reason: FramingReason
    length: int
    time_ns: int


FrameEvent = FrameReceived | FrameDiscarded


def slip_encode(data: bytes) -> bytes:
    """``data`` as a SLIP frame: END, the data with END and ESC escaped, END."""
    escaped = data.replace(_ESC_BYTE, _ESCAPED_ESC).replace(_END_BYTE, _ESCAPED_END)
    return _END_BYTE + escaped + _END_BYTE


class SlipDecoder:
    """Bytes of a line in, frames out, in the order of the line and independent of how the bytes are cut
    into chunks.

    - END always ends a frame, also after ESC, so that no garbage can swallow a frame that follows.
    - Nothing between two ENDs is no frame and no event.
    - A frame longer than ``max_frame_bytes`` after unescaping is discarded as OVERSIZED, one with a wrong
      escape as BAD_ESCAPE; which one is decided by what came first. Memory is bounded by
      ``max_frame_bytes``.
    """

    def __init__(self, max_frame_bytes: int) -> None:
        if max_frame_bytes < 1:
            raise LocalProtocolError("SlipDecoder", "max_frame_bytes", max_frame_bytes, "1 or more")
        self.max_frame_bytes = max_frame_bytes
        self._frame = bytearray()
        self._line_bytes = 0  # of the frame in progress, as they stand on the line
        self._escaping = False
        self._reason: FramingReason | None = None

    def receive(self, data: bytes, now_ns: int) -> list[FrameEvent]:
        """The frames that ``data``, arrived at ``now_ns``, completes."""
        events: list[FrameEvent] = []
        parts = bytes(data).split(_END_BYTE)
        for part in parts[:-1]:
            self._take(part)
            self._finish(events, now_ns)
        self._take(parts[-1])
        return events

    def reset(self) -> None:
        """Forget the frame in progress, as a restart of the receiver does."""
        self._frame.clear()
        self._line_bytes = 0
        self._escaping = False
        self._reason = None

    def _take(self, part: bytes) -> None:
        """Bytes without any END."""
        if not part:
            return
        self._line_bytes += len(part)
        if self._reason is not None:
            return
        if self._escaping:
            self._escaping = False
            if not self._unescape(part[0]):
                return
            part = part[1:]
        pieces = part.split(_ESC_BYTE)
        if not self._append(pieces[0]):
            return
        for index, piece in enumerate(pieces[1:], start=1):
            if not piece:
                if index == len(pieces) - 1:  # ESC is the last byte so far
                    self._escaping = True
                else:  # ESC ESC
                    self._fail(FramingReason.BAD_ESCAPE)
                return
            if not (self._unescape(piece[0]) and self._append(piece[1:])):
                return

    def _unescape(self, code: int) -> bool:
        if code == ESC_END:
            return self._append(_END_BYTE)
        if code == ESC_ESC:
            return self._append(_ESC_BYTE)
        self._fail(FramingReason.BAD_ESCAPE)
        return False

    def _append(self, piece: bytes) -> bool:
        if len(self._frame) + len(piece) > self.max_frame_bytes:
            self._fail(FramingReason.OVERSIZED)
            return False
        self._frame += piece
        return True

    def _fail(self, reason: FramingReason) -> None:
        self._reason = reason
        self._frame.clear()
        self._escaping = False

    def _finish(self, events: list[FrameEvent], now_ns: int) -> None:
        if self._escaping:
            self._fail(FramingReason.BAD_ESCAPE)
        if self._reason is not None:
            events.append(FrameDiscarded(self._reason, self._line_bytes, now_ns))
        elif self._frame:
            events.append(FrameReceived(bytes(self._frame), now_ns))
        self.reset()
