"""A CAN bus, by python-can: SocketCAN, an slcan adapter at a serial port, or a bus within this process.

The bytes of such a link are whole records (st_emulator.protocol.can.frames), one a frame. A bus is heard by
all: nobody sees who else is there, and what a receiver does not read in time is lost there, not here.
"""

from __future__ import annotations

import contextlib
from typing import Protocol

from can import CanOperationError
from can.interfaces.virtual import VirtualBus

from ...protocol.errors import LocalProtocolError
from ..link import ClosesOnExit, LinkError
from ..specification import LinkSpecification
from .records import MOST_FRAMES_A_READ, frame_to_send, message_of, record_of, records
from .slcan import OPENING_S, SlcanPort
from .socketcan import SocketPort

VIRTUAL_QUEUE_FRAMES = 65_536


class CanLink(ClosesOnExit):
    """One node of a CAN bus: `read` gives the records of others' frames, `write` takes records to be sent.

    interface: socketcan (channel: a network interface), slcan (a serial port) or virtual (any name; joins
    those who open the same in this process). bitrate: nominal, bit/s; set in an slcan adapter, demanded of a
    network interface that has one. fd: CAN FD frames pass too; without it those of others are not seen.
    SocketCAN's error messages are read like frames. Raises LinkError when the bus cannot be had.

    A frame that the driver does not take is dropped with all behind it in the same `write`, and so is what no
    controller sends (an error frame, an FD frame without `fd`, what is no record).
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        bitrate: int,
        fd: bool = False,
        *,
        opening_s: float = OPENING_S,
    ) -> None:
        specification = LinkSpecification("can", channel, interface=interface, bitrate=bitrate, fd=fd)
        self.name = str(specification)
        self.bitrate = bitrate
        self.fd = fd
        self.dropped_bytes = 0
        self._closed = False
        self._port: CanPort
        if interface == "socketcan":
            self._port = SocketPort(self.name, channel, bitrate, fd)
        elif interface == "slcan":
            self._port = SlcanPort(self.name, channel, bitrate, opening_s)
        elif interface == "virtual":
            self._port = _VirtualPort(channel, fd)
        else:
            raise LinkError(f"{self.name}: unknown CAN interface; allowed are socketcan, slcan and virtual")

    @property
    def hardware(self) -> bool:
        """Whether frames take their time on a real bus: not on vcan, vxcan and within this process."""
        return self._port.hardware

    @property
    def receive_overruns(self) -> int:
        """Frames of others so far that came when the kernel's buffer for this link was full (SocketCAN)."""
        return self._port.receive_overruns

    @property
    def unreadable_frames(self) -> int:
        """What came so far and was no frame: a garbled line of an slcan adapter."""
        return self._port.unreadable_frames

    def fileno(self) -> int | None:
        """The descriptor of SocketCAN and slcan; None for a bus within this process."""
        self._require_open()
        return self._port.fileno()

    def read(self) -> bytes:
        """The records of every frame that has arrived (at most `MOST_FRAMES_A_READ` at once)."""
        self._require_open()
        return self._port.read()

    def write(self, data: bytes) -> int:
        """Bytes of the leading records that the driver took; the others are dropped and counted."""
        self._require_open()
        taken = 0
        for record in records(data):
            if not self._port.send(record):
                break
            taken += len(record)
        self.dropped_bytes += len(data) - taken
        return taken

    def close(self) -> None:
        """Leave the bus."""
        if self._closed:
            return
        self._closed = True
        self._port.close()

    def _require_open(self) -> None:
        if self._closed:
            raise LinkError(f"{self.name}: the link is closed")


class CanPort(Protocol):
    """One of the three interfaces; LinkError when it has gone."""

    hardware: bool
    receive_overruns: int
    unreadable_frames: int

    def fileno(self) -> int | None: ...

    def read(self) -> bytes: ...

    def send(self, record: bytes) -> bool:
        """Whether the driver took it."""
        ...

    def close(self) -> None: ...


class _VirtualPort:
    """python-can's bus of this process. Its queues are bounded here, and as on vcan a receiver that does not
    read loses what does not fit: a sender must not be stopped by a node that listens no more.
    """

    hardware = False
    receive_overruns = 0

    def __init__(self, channel: str, fd: bool) -> None:
        self._fd = fd
        self.unreadable_frames = 0
        self._bus = VirtualBus(channel, rx_queue_size=VIRTUAL_QUEUE_FRAMES)

    def fileno(self) -> int | None:
        return None

    def read(self) -> bytes:
        received = bytearray()
        for _ in range(MOST_FRAMES_A_READ):
            message = self._bus.recv(timeout=0)
            if message is None:
                break
            if message.is_fd and not self._fd:
                continue
            try:
                received += record_of(message)
            except LocalProtocolError:
                self.unreadable_frames += 1
        return bytes(received)

    def send(self, record: bytes) -> bool:
        frame = frame_to_send(record, self._fd)
        if frame is None:
            return False
        with contextlib.suppress(CanOperationError):  # somebody's queue is full; the others have it
            self._bus.send(message_of(frame), timeout=0)
        return True

    def close(self) -> None:
        self._bus.shutdown()
