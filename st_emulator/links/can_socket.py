"""SocketCAN: a network interface of the kernel, real (can0) or virtual (vcan0)."""

from __future__ import annotations

import errno
import os
import socket
import struct
from pathlib import Path

from can import CanError
from can.interfaces.socketcan import SocketcanBus

from st_emulator.protocol.can_frames import FD_FLAG, RECORD_HEADER_BYTES, REMOTE_FLAG

from .can_records import MOST_FRAMES_A_READ, RECORD_HEADER, frame_to_send, one_line
from .link import LinkError

NETWORK_INTERFACES = Path("/sys/class/net")
CAN_INTERFACE_TYPE = 280  # ARPHRD_CAN of linux/if_arp.h
INTERFACE_UP = 0x1  # IFF_UP of linux/if.h
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

    def __init__(self, name: str, channel: str, fd: bool) -> None:
        self._name = name
        self._channel = channel
        self._fd = fd
        self._gone: str | None = None
        self.receive_overruns = 0
        _require_can_interface(name, channel, fd)
        try:
            self._bus = SocketcanBus(channel, receive_own_messages=False, fd=fd)
        except (OSError, CanError) as error:
            raise LinkError(f"{name}: {one_line(error)}") from error
        self._socket: socket.socket = self._bus.socket
        self._enlarge_receive_buffer()
        self.hardware = not _is_virtual(channel)

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
        try:
            for _ in range(MOST_FRAMES_A_READ):
                raw = receive(FD_FRAME.size, socket.MSG_DONTWAIT)
                layout = FD_FRAME if len(raw) == FD_FRAME.size else CLASSIC_FRAME
                word, length, flags, _, _, data = layout.unpack(raw)
                # What the kernel leaves in the flags of a classic frame means nothing.
                fd_flags = flags & 0x03 | FD_FLAG if layout is FD_FRAME else 0
                received += RECORD_HEADER.pack(word, length, fd_flags, 0)
                if not word & REMOTE_FLAG:
                    received += data[:length]
        except BlockingIOError:
            pass
        except OSError as error:
            gone = self._set_gone(error)
            if not received:
                raise gone from error
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
            what = f"the interface went down; bring it up, as root: {_up_command(self._channel)}"
        elif error.errno in (errno.ENODEV, errno.ENXIO):
            what = "the interface was removed"
        else:
            what = f"the bus failed: {error.strerror}"
        self._gone = f"{self._name}: {what}"
        return LinkError(self._gone)


def _require_can_interface(name: str, channel: str, fd: bool) -> None:
    """See why a bus could not be opened before it is tried: the kernel's own words explain little."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        if error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            raise LinkError(f"{name}: this computer's kernel has no CAN; {VCAN_HINT}") from error
        raise LinkError(f"{name}: no CAN socket to be had: {error.strerror}") from error
    try:
        socket.if_nametoindex(channel)
    except OSError:
        make = "`ip link` lists those there are"
        if channel.startswith("vcan"):
            make = f"make it, as root: ip link add dev {channel} type vcan && {_up_command(channel)}"
        raise LinkError(f"{name}: no such network interface; {make}, or {VCAN_HINT}") from None
    kind, flags, mtu = (_attribute(channel, key) for key in ("type", "flags", "mtu"))
    if kind not in (None, CAN_INTERFACE_TYPE):
        raise LinkError(f"{name}: this network interface is no CAN bus; `ip link show type can` lists those")
    if flags is not None and not flags & INTERFACE_UP:
        raise LinkError(f"{name}: the interface is down; bring it up, as root: {_up_command(channel)}")
    if fd and mtu is not None and mtu < FD_FRAME.size:
        how = (
            f"ip link set {channel} mtu {FD_FRAME.size}"
            if _is_virtual(channel)
            else f"ip link set {channel} type can fd on dbitrate BITRATE"
        )
        down = f"ip link set {channel} down && {how} && ip link set {channel} up"
        raise LinkError(f"{name}: the interface carries no CAN FD; leave out ,fd or, as root: {down}")


def _up_command(channel: str) -> str:
    virtual = channel.startswith("vcan") or _is_virtual(channel)
    return f"ip link set {channel} up{'' if virtual else ' type can bitrate BITRATE'}"


def _is_virtual(channel: str) -> bool:
    """Whether no device is behind a network interface. (The kernel's own slcan has none either: its tty is
    not its parent. It is known by its name, which slcand gives it.)
    """
    device = os.path.realpath(NETWORK_INTERFACES / channel)
    return "/devices/virtual/" in device and not channel.startswith("slcan")


def _attribute(channel: str, key: str) -> int | None:
    try:
        return int((NETWORK_INTERFACES / channel / key).read_text(), 0)
    except (OSError, ValueError):
        return None
