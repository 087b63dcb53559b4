"""The text after `--link`: what a person writes and what it means."""

from dataclasses import dataclass
from typing import Literal

from .link import LinkError

CAN_FORM = "can:INTERFACE/CHANNEL[@BITRATE][,fd]"
CAN_INTERFACES = ("socketcan", "slcan", "virtual")
CAN_EXAMPLES = "can:socketcan/vcan0, can:socketcan/can0@500000,fd, can:slcan//dev/ttyACM0 or can:virtual/NAME"
LINK_FORMS = f"none, pty, pty:PATH, serial:DEVICE, serial:DEVICE@BAUD or {CAN_FORM}"
MIN_BAUD = 300
MAX_BAUD = 4_000_000
MIN_BITRATE = 10_000  # the lowest of CiA 301's
MAX_BITRATE = 1_000_000  # the highest nominal bit rate of ISO 11898-2
MAX_INTERFACE_NAME = 15  # IFNAMSIZ of linux/if.h without the final 0

LinkKind = Literal["none", "pty", "serial", "can"]


@dataclass(frozen=True)
class LinkSpecification:
    """A link as asked for, before anything is opened.

    path: the stable link path of a pty, the device of a serial port, the channel of a CAN bus; None where
    the default is meant. baud: line rate if the text names one, else None (the unit's own). Of a CAN bus
    interface is one of `CAN_INTERFACES`, bitrate the nominal bit rate if the text names one (bit/s), fd
    whether CAN FD frames pass.
    """

    kind: LinkKind
    path: str | None = None
    baud: int | None = None
    interface: str | None = None
    bitrate: int | None = None
    fd: bool = False

    def __str__(self) -> str:
        path = "" if self.path is None else f":{self.path}"
        if self.kind == "can":
            path = f":{self.interface}/{self.path}"
        rate = self.bitrate if self.kind == "can" else self.baud
        return f"{self.kind}{path}{'' if rate is None else f'@{rate}'}{',fd' if self.fd else ''}"


def parse_link(text: str) -> LinkSpecification:
    """`none`, `pty`, `pty:PATH`, `serial:DEVICE`, `serial:DEVICE@BAUD`, a bare path (as `serial:PATH`), or
    `can:INTERFACE/CHANNEL[@BITRATE][,fd]`, where `can:slcan/dev/...` means the same as `can:slcan//dev/...`.

    LinkError names what is wrong and what is allowed. Nothing is opened or looked up.
    """
    if text.startswith(("/", "./", "../", "~")):
        return _serial(text, text)
    kind, colon, rest = text.partition(":")
    if kind == "serial":
        return _serial(text, rest)
    if kind == "can":
        return _can(text, rest)
    if kind == "pty":
        if colon and not rest:
            raise LinkError(f"link {text!r}: the path is missing; write pty or pty:PATH")
        return LinkSpecification("pty", rest or None)
    if kind == "none" and not colon:
        return LinkSpecification("none")
    raise LinkError(f"link {text!r}: unknown kind of link; allowed are {LINK_FORMS}")


def _serial(text: str, rest: str) -> LinkSpecification:
    device, at, rate = rest.rpartition("@")
    if not at:
        device, rate = rest, ""
    if not device:
        raise LinkError(f"link {text!r}: the device is missing; write serial:DEVICE or serial:DEVICE@BAUD")
    if not at:
        return LinkSpecification("serial", device)
    if not _is_number(rate) or not MIN_BAUD <= int(rate) <= MAX_BAUD:
        raise LinkError(f"link {text!r}: {rate!r} is no line rate; allowed are {MIN_BAUD} to {MAX_BAUD} baud")
    return LinkSpecification("serial", device, int(rate))


def _can(text: str, rest: str) -> LinkSpecification:
    rest, comma, option = rest.partition(",")
    if comma and option != "fd":
        raise LinkError(f"link {text!r}: unknown option {option!r}; allowed is fd, for CAN FD: {CAN_FORM}")
    interface, slash, rest = rest.partition("/")
    if interface not in CAN_INTERFACES:
        allowed = ", ".join(CAN_INTERFACES)
        raise LinkError(
            f"link {text!r}: unknown CAN interface {interface!r}; allowed are {allowed}, as in {CAN_EXAMPLES}"
        )
    channel, at, rate = rest.rpartition("@")
    if not at:
        channel, rate = rest, ""
    if not slash or not channel:
        raise LinkError(f"link {text!r}: the channel is missing; write {CAN_FORM}, as in {CAN_EXAMPLES}")
    if at and (not _is_number(rate) or not MIN_BITRATE <= int(rate) <= MAX_BITRATE):
        allowed = f"{MIN_BITRATE} to {MAX_BITRATE} bit/s"
        raise LinkError(f"link {text!r}: {rate!r} is no CAN bit rate; allowed are {allowed}")
    if interface == "slcan":
        if comma:
            raise LinkError(f"link {text!r}: slcan has no CAN FD; leave out ,fd or use socketcan")
        if channel.startswith("dev/"):
            channel = f"/{channel}"
    elif interface == "socketcan" and not _is_interface_name(channel):
        raise LinkError(
            f"link {text!r}: {channel!r} is no name of a network interface; write one as `ip link` lists it"
        )
    return LinkSpecification(
        "can", channel, interface=interface, bitrate=int(rate) if at else None, fd=bool(comma)
    )


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit()


def _is_interface_name(text: str) -> bool:
    """What the kernel takes as a network interface's name (dev_valid_name of net/core/dev.c)."""
    unfit = text in (".", "..") or any(mark in "/:" or mark.isspace() for mark in text)
    return 0 < len(text.encode()) <= MAX_INTERFACE_NAME and not unfit
