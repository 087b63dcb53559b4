"""What ISO 15765-2 makes of each frame that a receiver of classic CAN gets: a second reading of its tables,
by patterns over the frame as text. It has no timers: the frames come one right after the other.
"""

from __future__ import annotations

import re

# Frame (hexadecimal) -> kind. 9.6.1 table 9, 9.6.2.2, 9.6.3.2, 10.4.3.
KINDS = [
    ("single", re.compile("".join(f"(?P<s{n}>0{n}(?:..){{{n},7}})|" for n in range(1, 8)).rstrip("|"))),
    ("first", re.compile("1(?!000)(?!00[0-7])(?P<length>...)(?P<data>(?:..){6})")),
    ("long first", re.compile("1000(?!00000)(?!00000...)(?P<length>.{8})(?P<data>(?:..){2})")),
    ("flow", re.compile("3.(?:..){2,7}")),
    ("consecutive", re.compile("2(?P<number>.)(?P<data>(?:..){0,7})")),
    ("reserved", re.compile("[4-9A-F].(?:..){0,7}")),
]


class Reference:
    """``takes`` gives the names of the events that a frame causes; ``asked`` is the flow control to send."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self.rest: int | None = None  # bytes that are still missing
        self.collected = ""
        self.number = 0
        self.asked: str | None = None

    def takes(self, frame: str) -> list[str]:
        for kind, pattern in KINDS:
            if match := pattern.fullmatch(frame):
                return getattr(self, kind.replace(" ", "_"))(match)
        return ["ignored BAD_LENGTH"]

    def interrupted(self) -> list[str]:
        before, self.rest = self.rest, None
        if before is None:
            return []
        self.asked = None
        return ["failed UNEXPECTED_PDU"]

    def single(self, match: re.Match[str]) -> list[str]:
        frame = match.group()
        return [*self.interrupted(), f"received {frame[2 : 2 + 2 * int(frame[1])]}"]

    def first(self, match: re.Match[str]) -> list[str]:
        length, events = int(match["length"], 16), self.interrupted()
        if length > self.max_bytes:
            self.asked = "32"
            return [*events, "failed TOO_LONG"]
        self.collected, self.number, self.asked = match["data"], 1, "30"
        self.rest = length - len(match["data"]) // 2
        return events

    long_first = first

    def flow(self, match: re.Match[str]) -> list[str]:
        return ["ignored UNEXPECTED_PDU"]  # nothing is being sent

    def consecutive(self, match: re.Match[str]) -> list[str]:
        if self.rest is None:
            return ["ignored UNEXPECTED_PDU"]
        if len(match["data"]) < 2 * min(7, self.rest):
            return ["ignored BAD_LENGTH"]
        if int(match["number"], 16) != self.number % 16:
            self.rest = self.asked = None
            return ["failed WRONG_SEQUENCE"]
        self.number += 1
        self.collected += match["data"][: 2 * self.rest]
        self.rest -= 7
        if self.rest > 0:
            return []
        self.rest = self.asked = None
        return [f"received {self.collected}"]

    def reserved(self, match: re.Match[str]) -> list[str]:
        return ["ignored BAD_PCI"]
