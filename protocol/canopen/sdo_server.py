"""The server of service data objects (CiA 301, 7.2.4.3): a client's frame and a time in, answers out.

One transfer at a time. A request that begins another gives the one under way up, without an abort.
ASSUMED: the standard leaves that open, and a client whose transfer was lost begins anew.
"""

from __future__ import annotations

from typing import Protocol

from .sdo import (
    BLOCK_SIZE_INDICATED,
    CRC_SUPPORTED,
    EXPEDITED,
    FRAME_BYTES,
    LAST_SEGMENT,
    MOST_BLOCK_SEGMENTS,
    SIZE_INDICATED,
    AbortCode,
    BlockCommand,
    ClientCommand,
    ServerCommand,
    abort_frame,
)
from .transfers import BlockDownload, BlockUpload, SegmentedDownload, SegmentedUpload, Transfer, padded

EXPEDITED_BYTES = 4


class Objects(Protocol):
    """What the server reads and writes."""

    def read(self, index: int, sub: int) -> bytes | AbortCode: ...

    def writable_bytes(self, index: int, sub: int) -> tuple[int, int] | AbortCode: ...

    def write(self, index: int, sub: int, data: bytes, at_ns: int) -> AbortCode | None: ...


class SdoServer:
    """One channel.

    Args:
        objects: the dictionary.
        timeout_ns: of a transfer: so long the client may be silent.
        block_size: segments of a block that the server takes.
    """

    def __init__(self, objects: Objects, timeout_ns: int, block_size: int = MOST_BLOCK_SEGMENTS) -> None:
        self._objects = objects
        self._timeout_ns = timeout_ns
        self._block_size = block_size
        self._transfer: Transfer | None = None
        self._deadline_ns = 0
        self.aborts = 0

    def reset(self) -> None:
        """No transfer is under way; nothing is said."""
        self._transfer = None

    @property
    def busy(self) -> bool:
        """Whether a transfer is under way."""
        return self._transfer is not None

    def next_deadline_ns(self) -> int | None:
        """When :meth:`poll` has to be called though nothing happens; None when never."""
        return None if self._transfer is None else self._deadline_ns

    def touch(self, now_ns: int) -> None:
        """The time-out counts from now: a frame of the server has left only now."""
        self._deadline_ns = now_ns + self._timeout_ns

    def poll(self, now_ns: int) -> list[bytes]:
        """What the time brings: the abort of a transfer whose client is silent."""
        if self._transfer is None or now_ns < self._deadline_ns:
            return []
        return [self._abort(self._transfer.index, self._transfer.sub, AbortCode.TIMED_OUT)]

    def receive(self, request: bytes, now_ns: int) -> list[bytes]:
        """A client's frame; returns the answers in their order.

        A frame that has not 8 octets is none of SDO and is ignored (ASSUMED, as an abort could not name an
        object).
        """
        if len(request) != FRAME_BYTES:
            return []
        answers = self._answers(request, now_ns)
        self.touch(now_ns)
        return answers

    def _answers(self, request: bytes, now_ns: int) -> list[bytes]:
        transfer = self._transfer
        if isinstance(transfer, BlockDownload) and not transfer.complete:
            if request[0] == ClientCommand.ABORT << 5:
                self._transfer = None
                return []
            return self._block_segment(transfer, request)
        index, sub = int.from_bytes(request[1:3], "little"), request[3]
        match request[0] >> 5:
            case ClientCommand.ABORT:
                self._transfer = None
                return []
            case ClientCommand.INITIATE_DOWNLOAD:
                return self._initiate_download(request, index, sub, now_ns)
            case ClientCommand.INITIATE_UPLOAD:
                return self._initiate_upload(index, sub)
            case ClientCommand.DOWNLOAD_SEGMENT:
                if isinstance(transfer, SegmentedDownload):
                    return self._download_segment(transfer, request, now_ns)
            case ClientCommand.UPLOAD_SEGMENT:
                if isinstance(transfer, SegmentedUpload):
                    return self._upload_segment(transfer, request[0])
            case ClientCommand.BLOCK_DOWNLOAD:
                if not request[0] & BlockCommand.END:
                    return self._initiate_block_download(request, index, sub)
                if isinstance(transfer, BlockDownload):
                    return self._end_block_download(transfer, request, now_ns)
            case ClientCommand.BLOCK_UPLOAD:
                if request[0] & 3 == BlockCommand.INITIATE:
                    return self._initiate_block_upload(request, index, sub)
                if isinstance(transfer, BlockUpload):
                    return self._continue_block_upload(transfer, request)
        if transfer is not None:
            index, sub = transfer.index, transfer.sub
        return [self._abort(index, sub, AbortCode.COMMAND)]

    def _abort(self, index: int, sub: int, code: AbortCode) -> bytes:
        self._transfer = None
        self.aborts += 1
        return abort_frame(index, sub, code)

    def _written(self, index: int, sub: int, data: bytes, now_ns: int, answer: bytes) -> list[bytes]:
        """The whole value is here: write it; ``answer`` if that went well."""
        self._transfer = None
        refused = self._objects.write(index, sub, data, now_ns)
        return [answer] if refused is None else [self._abort(index, sub, refused)]

    def _limits(self, index: int, sub: int, size: int | None) -> tuple[int, int] | AbortCode:
        """(fewest, most) octets of an object that is to be written with ``size`` octets."""
        limits = self._objects.writable_bytes(index, sub)
        if isinstance(limits, AbortCode) or size is None:
            return limits
        if size > limits[1]:
            return AbortCode.TOO_LONG
        return AbortCode.TOO_SHORT if size < limits[0] else limits

    # -- download: to the server

    def _initiate_download(self, request: bytes, index: int, sub: int, now_ns: int) -> list[bytes]:
        self._transfer = None
        command = request[0]
        expedited, sized = bool(command & EXPEDITED), bool(command & SIZE_INDICATED)
        size: int | None = None
        if sized:
            size = (
                EXPEDITED_BYTES - (command >> 2 & 3) if expedited else int.from_bytes(request[4:], "little")
            )
        limits = self._limits(index, sub, size)
        if isinstance(limits, AbortCode):
            return [self._abort(index, sub, limits)]
        answer = padded(bytes((ServerCommand.INITIATE_DOWNLOAD << 5,)) + request[1:4])
        if not expedited:
            self._transfer = SegmentedDownload(index, sub, size, limits[1])
            return [answer]
        if size is None:  # as many as the object has
            size = min(limits[1], EXPEDITED_BYTES)
        return self._written(index, sub, request[4 : 4 + size], now_ns, answer)

    def _download_segment(self, transfer: SegmentedDownload, request: bytes, now_ns: int) -> list[bytes]:
        index, sub = transfer.index, transfer.sub
        answer = transfer.segment(request)
        if isinstance(answer, AbortCode):
            return [self._abort(index, sub, answer)]
        if not request[0] & LAST_SEGMENT:
            return [answer]
        if transfer.size not in (None, len(transfer.data)):
            return [self._abort(index, sub, AbortCode.LENGTH)]
        return self._written(index, sub, bytes(transfer.data), now_ns, answer)

    def _initiate_block_download(self, request: bytes, index: int, sub: int) -> list[bytes]:
        self._transfer = None
        sized, with_crc = request[0] & BLOCK_SIZE_INDICATED, bool(request[0] & CRC_SUPPORTED)
        size = int.from_bytes(request[4:], "little") if sized else None
        limits = self._limits(index, sub, size)
        if isinstance(limits, AbortCode):
            return [self._abort(index, sub, limits)]
        self._transfer = BlockDownload(index, sub, size, limits[1], with_crc, self._block_size)
        # ASSUMED: CRC is announced where the client announces it: some clients take the server's word alone.
        first = ServerCommand.BLOCK_DOWNLOAD << 5 | request[0] & CRC_SUPPORTED | BlockCommand.INITIATE
        return [padded(bytes((first,)) + request[1:4] + bytes((self._block_size,)))]

    def _block_segment(self, transfer: BlockDownload, request: bytes) -> list[bytes]:
        answer = transfer.segment(request)
        if isinstance(answer, AbortCode):
            return [self._abort(transfer.index, transfer.sub, answer)]
        return [] if answer is None else [answer]

    def _end_block_download(self, transfer: BlockDownload, request: bytes, now_ns: int) -> list[bytes]:
        index, sub = transfer.index, transfer.sub
        data = transfer.end(request)
        if not isinstance(data, AbortCode) and transfer.size not in (None, len(data)):
            data = AbortCode.LENGTH
        if isinstance(data, AbortCode):
            return [self._abort(index, sub, data)]
        answer = padded(bytes((ServerCommand.BLOCK_DOWNLOAD << 5 | BlockCommand.END,)))
        return self._written(index, sub, data, now_ns, answer)

    # -- upload: from the server

    def _initiate_upload(self, index: int, sub: int) -> list[bytes]:
        self._transfer = None
        data = self._objects.read(index, sub)
        if isinstance(data, AbortCode):
            return [self._abort(index, sub, data)]
        return [self._upload_answer(index, sub, data)]

    def _upload_answer(self, index: int, sub: int, data: bytes) -> bytes:
        place = index.to_bytes(2, "little") + bytes((sub,))
        first = ServerCommand.INITIATE_UPLOAD << 5 | SIZE_INDICATED
        if 1 <= len(data) <= EXPEDITED_BYTES:
            first |= EXPEDITED | (EXPEDITED_BYTES - len(data)) << 2
            return padded(bytes((first,)) + place + data)
        self._transfer = SegmentedUpload(index, sub, data)
        return bytes((first,)) + place + len(data).to_bytes(4, "little")

    def _upload_segment(self, transfer: SegmentedUpload, command: int) -> list[bytes]:
        answer = transfer.segment(command)
        if isinstance(answer, AbortCode):
            return [self._abort(transfer.index, transfer.sub, answer)]
        if transfer.ended:
            self._transfer = None
        return [answer]

    def _initiate_block_upload(self, request: bytes, index: int, sub: int) -> list[bytes]:
        self._transfer = None
        block_size, switch_bytes = request[4], request[5]
        if not 1 <= block_size <= MOST_BLOCK_SEGMENTS:
            return [self._abort(index, sub, AbortCode.BLOCK_SIZE)]
        data = self._objects.read(index, sub)
        if isinstance(data, AbortCode):
            return [self._abort(index, sub, data)]
        if switch_bytes and len(data) <= switch_bytes:  # the client lets the server change the protocol
            return [self._upload_answer(index, sub, data)]
        with_crc = bool(request[0] & CRC_SUPPORTED)
        self._transfer = BlockUpload(index, sub, data, with_crc, block_size)
        first = ServerCommand.BLOCK_UPLOAD << 5 | request[0] & CRC_SUPPORTED | BLOCK_SIZE_INDICATED
        return [bytes((first,)) + request[1:4] + len(data).to_bytes(4, "little")]

    def _continue_block_upload(self, transfer: BlockUpload, request: bytes) -> list[bytes]:
        index, sub = transfer.index, transfer.sub
        match request[0] & 3:
            case BlockCommand.START_UPLOAD if not transfer.started:
                transfer.started = True
                return transfer.block()
            case BlockCommand.ACKNOWLEDGE if transfer.started and not transfer.ending:
                answers = transfer.acknowledged(request[1], request[2])
                if isinstance(answers, AbortCode):
                    return [self._abort(index, sub, answers)]
                return answers
            case BlockCommand.END if transfer.ending:
                self._transfer = None
                return []
        return [self._abort(index, sub, AbortCode.COMMAND)]
