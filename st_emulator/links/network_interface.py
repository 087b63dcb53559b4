"""What the kernel says of a network interface, asked over netlink: unlike /sys it answers for the network
namespace that the process is in, and it knows what kind of interface a driver makes.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

HEADER = struct.Struct("=IHHII")  # struct nlmsghdr of linux/netlink.h
INTERFACE = struct.Struct("=BxHiII")  # struct ifinfomsg of linux/rtnetlink.h
ATTRIBUTE = struct.Struct("=HH")  # struct rtattr
REQUEST = 1  # NLM_F_REQUEST
NEW_LINK, GET_LINK = 16, 18  # RTM_*
MTU, LINK_INFO = 4, 18  # IFLA_*, linux/if_link.h
INFO_KIND, INFO_DATA = 1, 2  # IFLA_INFO_*
CAN_BIT_TIMING = 1  # IFLA_CAN_*, linux/can/netlink.h; it begins with the bit rate
ATTRIBUTE_TYPE = 0x3FFF  # NLA_TYPE_MASK
IS_UP = 1  # IFF_UP
CAN_TYPE = 280  # ARPHRD_CAN of linux/if_arp.h
ANSWER_BYTES = 65536


@dataclass(frozen=True)
class NetworkInterface:
    """mtu: bytes, 0 where not said. kind: the driver's family (vcan, can, slcan, ...), "" where it has none.
    bitrate: what a CAN controller is set to, bit/s; 0 where not said.
    """

    is_can: bool
    is_up: bool
    mtu: int
    kind: str
    bitrate: int


def network_interface(name: str) -> NetworkInterface | None:
    """The interface of this name; None: there is none. OSError when the kernel cannot be asked."""
    try:
        index = socket.if_nametoindex(name)
    except OSError:
        return None
    request = HEADER.pack(HEADER.size + INTERFACE.size, GET_LINK, REQUEST, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as asked:
        asked.send(request + INTERFACE.pack(socket.AF_UNSPEC, 0, index, 0, 0))
        answer = asked.recv(ANSWER_BYTES)
    length, kind_of_answer, *_ = HEADER.unpack_from(answer)
    if kind_of_answer != NEW_LINK:  # an error: it has gone meanwhile
        return None
    _, interface_type, _, flags, _ = INTERFACE.unpack_from(answer, HEADER.size)
    found = dict(_attributes(answer[HEADER.size + INTERFACE.size : length]))
    info = dict(_attributes(found.get(LINK_INFO, b"")))
    data = dict(_attributes(info.get(INFO_DATA, b"")))
    kind = info.get(INFO_KIND, b"").rstrip(b"\0").decode("ascii", "replace")
    is_can = interface_type == CAN_TYPE
    return NetworkInterface(
        is_can=is_can,
        is_up=bool(flags & IS_UP),
        mtu=_number(found.get(MTU, b"")),
        kind=kind,
        bitrate=_number(data.get(CAN_BIT_TIMING, b"")) if is_can and kind in ("can", "slcan") else 0,
    )


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Type and content of each attribute in a row of them."""
    start = 0
    while start + ATTRIBUTE.size <= len(data):
        length, kind = ATTRIBUTE.unpack_from(data, start)
        if length < ATTRIBUTE.size:
            return
        yield kind & ATTRIBUTE_TYPE, data[start + ATTRIBUTE.size : start + length]
        start += length + 3 & ~3


def _number(data: bytes) -> int:
    """The first number of four bytes."""
    return struct.unpack_from("=I", data)[0] if len(data) >= 4 else 0
