"""The control protocol's lines: JSON objects of bounded length, one a line, over a loopback connection.

A request is ``{"id": 7, "do": "step_to", ...}``; its answer ``{"id": 7, "ok": true, ...}`` or
``{"id": 7, "ok": false, "error": {"kind": "paused", "text": "..."}}``. Answers come in the order of requests.
Of the standard library alone, as clients import it. Described in docs/lockstep.md.
"""

from __future__ import annotations

import json
from typing import Any

PROTOCOL = "st-emulator control"
VERSION = 1
MOST_LINE_BYTES = 1 << 18
"""Of a request, with its end."""
MOST_TAKEN_BYTES = 1 << 16
"""Of the unit's bytes in one answer."""
DEEPEST = 16

ERROR_KINDS = {
    "malformed": "the line is no JSON object of this protocol; it is left out",
    "oversized": "the line is longer than allowed; it is left out",
    "unauthorised": "no hello came first, or its token is wrong; the connection is closed",
    "version": "the client speaks another version; the connection is closed",
    "busy": "another client is there; the connection is closed",
    "taken_over": "this client was silent and another one has taken over; the connection is closed",
    "unknown": "there is no such request",
    "argument": "an argument is missing or is not what is allowed",
    "refused": "the request makes no sense in this run or at this time",
    "paused": "the unit is paused; first resume",
    "beyond_truth": "an exposure ended whose true attitude is not given; give it and step on",
}


class LineError(Exception):
    """What is wrong with a request; ``kind``: one of ERROR_KINDS."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


def encoded(message: dict[str, Any]) -> bytes:
    """A message as a line."""
    return json.dumps(message, separators=(",", ":")).encode("ascii") + b"\n"


def decoded(line: bytes) -> dict[str, Any]:
    """The message of a line. Raises LineError for one that is none."""
    try:
        message = json.loads(line.decode("utf-8"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise LineError("malformed", f"not a line of JSON: {str(error)[:80]}") from error
    if not isinstance(message, dict):
        raise LineError("malformed", "a line has to hold one JSON object")
    return message


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")
