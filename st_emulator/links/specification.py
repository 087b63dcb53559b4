"""The text after `--link`: what a person writes and what it means."""

from dataclasses import dataclass
from typing import Literal

from .link import LinkError

LINK_FORMS = "none, pty, pty:PATH, serial:DEVICE or serial:DEVICE@BAUD"
MIN_BAUD = 300
MAX_BAUD = 4_000_000

LinkKind = Literal["none", "pty", "serial"]


@dataclass(frozen=True)
class LinkSpecification:
    """A link as asked for, before anything is opened.

    path: the stable link path of a pty or the device of a serial port; None where the default is meant.
    baud: line rate if the text names one, else None (the unit's own).
    """

    kind: LinkKind
    path: str | None = None
    baud: int | None = None

    def __str__(self) -> str:
        path = "" if self.path is None else f":{self.path}"
        baud = "" if self.baud is None else f"@{self.baud}"
        return f"{self.kind}{path}{baud}"


def parse_link(text: str) -> LinkSpecification:
    """`none`, `pty`, `pty:PATH`, `serial:DEVICE`, `serial:DEVICE@BAUD`, or a bare path (as `serial:PATH`).

    LinkError names what is wrong and what is allowed. Nothing is opened or looked up.
    """
    if text.startswith(("/", "./", "../", "~")):
        return _serial(text, text)
    kind, colon, rest = text.partition(":")
    if kind == "serial":
        return _serial(text, rest)
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
    if not (rate.isascii() and rate.isdigit()) or not MIN_BAUD <= int(rate) <= MAX_BAUD:
        raise LinkError(f"link {text!r}: {rate!r} is no line rate; allowed are {MIN_BAUD} to {MAX_BAUD} baud")
    return LinkSpecification("serial", device, int(rate))
