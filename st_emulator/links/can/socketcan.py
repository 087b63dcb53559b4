"""SocketCAN: a network interface of the kernel, real (can0) or virtual (vcan0)."""

from __future__ import annotations

import errno
import socket
import struct

from can import CanError
from can.interfaces.socketcan import SocketcanBus

from ...protocol.can.frames import FD_FLAG, RECORD_HEADER_BYTES, REMOTE_FLAG
from ..link import LinkError
from ..network_interface import NetworkInterface, network_interface
from .records import MOST_FRAMES_A_READ, RECORD_HEADER, frame_to_send, one_line

VIRTUAL_KINDS = ("vcan", "vxcan")  # no bus that takes time behind these drivers
CLASSIC_FRAME = struct.Struct("=IBBBB8s")  # struct can_frame of linux/can.h
FD_FRAME = struct.Struct("=IBBBB64s")  # struct canfd_frame; its size tells the two apart
RECEIVE_BUFFER_BYTES = 16 * 1024 * 1024  # the kernel takes some 800 bytes a frame: 20,000 frames and more
SO_RCVBUFFORCE = 33  # asm-generic/socket.h; the module socket has no names for these two
SO_MEMINFO = 55
MEMINFO = struct.Struct("=9I")  # SK_MEMINFO_* of linux/sock_diag.h; the last counts what did not fit
VCAN_HINT = "./tools/vcan COMMAND runs a command where there is a vcan0"


class SocketPort:
    """python-can opens and sets up the socket; frames then pass without its messages.

    The kernel's frame and a record differ in the order of four bytes only, so one system call and no object
    a frame is enough: a busy bus carries ten thousand a second.
    """

    unreadable_frames = 0

    def __init__(self, name: str, channel: str, bitrate: int, fd: bool) -> None:
        self._name = name
        self._channel = channel
        self._fd = fd
        self._gone: str | None = None
        self.receive_overruns = 0
        self._interface = _require_can_interface(name, channel, bitrate, fd)
        self.hardware = self._interface.kind not in VIRTUAL_KINDS
        try:
            self._bus = SocketcanBus(channel, receive_own_messages=False, fd=fd)
        except (OSError, CanError) as error:
            raise LinkError(f"{name}: {one_line(error)}") from error
        self._socket: socket.socket = self._bus.socket
        self._enlarge_receive_buffer()

    def _enlarge_receive_buffer(self) -> None:
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
        except OSError:  # not root: as much as net.core.rmem_max allows
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)

    def fileno(self) -> int | None:
        return self._socket.fileno()

    def read(self) -> bytes:
        if self._gone is not None:
            raise LinkError(self._gone)
        received = bytearray()
        receive = self._socket.recv
        for _ in range(MOST_FRAMES_A_READ):
            try:
                raw = receive(FD_FRAME.size, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError as error:
                if self._gone is not None:
                    break
                self._set_gone(error)  # said before what had come until then
                continue
            layout = FD_FRAME if len(raw) == FD_FRAME.size else CLASSIC_FRAME
            word, length, flags, _, _, data = layout.unpack(raw)
            # What the kernel leaves in the flags of a classic frame means nothing.
            fd_flags = flags & 0x03 | FD_FLAG if layout is FD_FRAME else 0
            received += RECORD_HEADER.pack(word, length, fd_flags, 0)
            if not word & REMOTE_FLAG:
                received += data[:length]
        if not received and self._gone is not None:
            raise LinkError(self._gone)
        if received:
            self._count_overruns()
        return bytes(received)

    def send(self, record: bytes) -> bool:
        if self._gone is not None:
            raise LinkError(self._gone)
        word, length, flags, _ = RECORD_HEADER.unpack_from(record)
        layout = FD_FRAME if flags & FD_FLAG else CLASSIC_FRAME
        if frame_to_send(record, self._fd) is None:
            return False
        raw = layout.pack(word, length, flags, 0, 0, record[RECORD_HEADER_BYTES:])
        try:
            self._socket.send(raw, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno == errno.ENOBUFS:  # the controller's queue is full
                return False
            raise self._set_gone(error) from error
        return True

    def close(self) -> None:
        self._bus.shutdown()

    def _count_overruns(self) -> None:
        try:
            counts = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
        except OSError:  # before Linux 4.12
            return
        if len(counts) == MEMINFO.size:
            self.receive_overruns = MEMINFO.unpack(counts)[-1]

    def _set_gone(self, error: OSError) -> LinkError:
        """The kernel says once that an interface went down; the link says so from then on."""
        if error.errno == errno.ENETDOWN:
            up = _up_command(self._channel, self._interface)
            what = f"the interface went down; bring it up, as root: {up}"
        elif error.errno in (errno.ENODEV, errno.ENXIO):
            what = "the interface was removed"
        else:
            what = f"the bus failed: {error.strerror}"
        self._gone = f"{self._name}: {what}"
        return LinkError(self._gone)


def _require_can_interface(name: str, channel: str, bitrate: int, fd: bool) -> NetworkInterface:
    """See why a bus could not be opened before it is tried: the kernel's own words explain little."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
        interface = network_interface(channel)
    except OSError as error:
        if error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            raise LinkError(f"{name}: this computer's kernel has no CAN; {VCAN_HINT}") from error
        raise LinkError(f"{name}: no CAN socket to be had: {error.strerror}") from error
    if interface is None:
        make = "`ip link` lists those there are"
        if channel.startswith("vcan"):
            make = f"make it, as root: ip link add dev {channel} type vcan && ip link set {channel} up"
        raise LinkError(f"{name}: no such network interface; {make}; {VCAN_HINT}")
    if not interface.is_can:
        raise LinkError(f"{name}: this network interface is no CAN bus; name one, such as can0 or vcan0")
    if not interface.is_up:
        raise LinkError(
            f"{name}: the interface is down; bring it up, as root: {_up_command(channel, interface)}"
        )
    if interface.bitrate not in (0, bitrate):
        raise LinkError(
            f"{name}: the interface is set to {interface.bitrate} bit/s; ask for @{interface.bitrate} or, as "
            f"root: ip link set {channel} down && ip link set {channel} up type can bitrate {bitrate}"
        )
    if fd and interface.mtu < FD_FRAME.size:
        virtual = interface.kind in VIRTUAL_KINDS
        how = f"mtu {FD_FRAME.size}" if virtual else "type can fd on dbitrate BITRATE"
        steps = " && ".join(f"ip link set {channel} {step}" for step in ("down", how, "up"))
        raise LinkError(f"{name}: the interface carries no CAN FD; leave out ,fd or, as root: {steps}")
    return interface


def _up_command(channel: str, interface: NetworkInterface) -> str:
    is_set = interface.kind in VIRTUAL_KINDS or interface.bitrate
    settings = "" if is_set else " type can bitrate BITRATE"
    return f"ip link set {channel} up{settings}"
