"""A UART of eight data bits without parity that reads what another one sends at another rate.

The wave form is that of back-to-back octets, a start bit (0), eight data bits from the least significant on,
a stop bit (1), between lines at rest (1). The receiver waits for a falling edge, looks at the line in the
middle of each bit by its own clock, and waits for the next falling edge behind the stop bit's middle.
Source of the scheme: 16450/16550 data sheets (sixteenfold clock, mid-bit sampling).
ASSUMED: an edge and a sample are exact, without the sixteenth of a bit by which a real one is late.
"""

from __future__ import annotations

import math
from typing import NamedTuple

DATA_BITS = 8
STOP_BIT = 9
BITS_PER_OCTET = 10


class ReadOctet(NamedTuple):
    """``framing_error``: its stop bit was low."""

    value: int
    framing_error: bool


def wave_form(octets: bytes) -> list[int]:
    """The level of the line in each bit time of the sender."""
    bits: list[int] = []
    for octet in octets:
        bits += [0, *(octet >> place & 1 for place in range(DATA_BITS)), 1]
    return bits


def read(octets: bytes, ratio: float) -> list[ReadOctet]:
    """What a receiver makes of ``octets``.

    Args:
        octets: sent without a pause between them; the line rests before and behind.
        ratio: bit rate of the sender over that of the receiver, above 0.
    """
    bits = wave_form(octets)

    def level(at: float) -> int:
        place = math.floor(at)
        return bits[place] if 0 <= place < len(bits) else 1

    found: list[ReadOctet] = []
    edge = _falling_edge(bits, 0)
    while edge is not None:
        middle = edge + 0.5 * ratio
        if level(middle):  # no start bit but a short dip
            edge = _falling_edge(bits, math.floor(middle) + 1)
            continue
        value = sum(level(middle + (1 + place) * ratio) << place for place in range(DATA_BITS))
        stop = middle + STOP_BIT * ratio
        found.append(ReadOctet(value, not level(stop)))
        edge = _falling_edge(bits, math.floor(stop) + 1)
    return found


def _falling_edge(bits: list[int], start: int) -> int | None:
    """The first bit from ``start`` on that is low behind one that is high."""
    for place in range(start, len(bits)):
        if not bits[place] and (place == 0 or bits[place - 1]):
            return place
    return None
