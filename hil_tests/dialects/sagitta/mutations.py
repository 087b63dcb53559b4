"""Mutated traffic to a running unit: nothing may raise, and good requests are answered after it.

``python -m hil_tests.dialects.sagitta.mutations COUNT SEED`` from the root.
"""

from __future__ import annotations

import random
import sys
import time
from dataclasses import dataclass

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import Bench, line_ns, make
from hil_tests.dialects.sagitta.client import ACTION, READ, REQUEST, SET

PIECE_BYTES = 600  # between two checks that the unit still answers, on average
DRAIN_MS = 500.0  # a full queue of the unit has left after 356 ms


@dataclass
class Report:
    """What was done. ``answered``: good requests that were answered, all of those that were sent."""

    octets: int = 0
    good: int = 0
    answered: int = 0
    frames_from_unit: int = 0
    seconds: float = 0.0


def _good(chance: random.Random) -> bytes:
    """A request that is right in form, with arguments that may be anything."""
    kind = chance.randrange(10)
    if kind < 3:
        id_ = chance.choice(list(client.PARAMETER_BYTES))
        arguments = client.DEFAULTS[id_]
        if chance.random() < 0.3:
            arguments = chance.randbytes(len(arguments))
        return client.request(SET, id_, arguments)
    if kind < 6:
        return client.request(READ, chance.choice(list(client.PARAMETER_BYTES)))
    if kind < 9:
        return client.request(REQUEST, chance.choice(list(client.TELEMETRY_BODY_BYTES)))
    if chance.random() < 0.5:
        # Before 2094, where the device's clock ends, and mostly before what is known of leap seconds.
        return client.request(ACTION, client.SET_TIME, chance.randrange(2**51).to_bytes(8, "little"))
    return client.request(ACTION, client.BOOT, b"\x01")


def _flip(chance: random.Random, octets: bytearray) -> None:
    for _ in range(chance.randint(1, 4)):
        octets[chance.randrange(len(octets))] ^= 1 << chance.randrange(8)


def _cut(chance: random.Random, octets: bytearray) -> None:
    begin = chance.randrange(len(octets))
    del octets[begin : begin + chance.randint(1, 8)]


def _insert(chance: random.Random, octets: bytearray) -> None:
    place = chance.randint(0, len(octets))
    octets[place:place] = bytes(
        chance.choices((0xC0, 0xDB, 0xDC, 0xDD, 0x21, 0x00, 0xFF), k=chance.randint(1, 6))
    )


def _swap(chance: random.Random, octets: bytearray) -> None:
    one, other = chance.randrange(len(octets)), chance.randrange(len(octets))
    octets[one], octets[other] = octets[other], octets[one]


def _lengthen(chance: random.Random, octets: bytearray) -> None:
    """A right hash over arguments of another length, or another type or id."""
    type_, id_ = chance.randrange(256), chance.randrange(256)
    if chance.random() < 0.7:
        type_ = chance.randrange(4)
    octets[:] = client.request(type_, id_, chance.randbytes(chance.randint(0, 140)))


def _random(chance: random.Random, octets: bytearray) -> None:
    octets[:] = chance.randbytes(chance.randint(1, 60))


def _none(chance: random.Random, octets: bytearray) -> None:
    pass


MUTATIONS = (_flip, _cut, _insert, _swap, _lengthen, _random, _none)


def _still_answers(bench: Bench) -> None:
    """After what is in work a good request is answered, as it should be."""
    bench.put(b"\xc0")
    bench.run(DRAIN_MS)
    frame = bench.one(READ, 6)
    assert len(frame.arguments) == 16, frame


def mutate(count: int, seed: int) -> Report:
    """Feed ``count`` octets to a unit that tracks, in pieces; raises where anything goes wrong."""
    chance = random.Random(seed)
    begun_s = time.perf_counter()
    bench = make().boot()
    report = Report()
    since = 0
    while report.octets < count:
        octets = bytearray(_good(chance))
        if len(octets):
            chance.choice(MUTATIONS)(chance, octets)
        while octets:
            size = chance.randint(1, len(octets))
            bench.put(bytes(octets[:size]))
            bench.run(line_ns(size) / 1e6 * chance.choice((0, 1, 1.2)))
            report.octets += size
            since += size
            del octets[:size]
        report.good += 1
        if since > PIECE_BYTES:
            since = 0
            _still_answers(bench)
            report.answered += 1
            report.frames_from_unit += len(bench.frames)
            bench.frames.clear()
            bench.groups.clear()
    _still_answers(bench)
    report.answered += 1
    report.frames_from_unit += len(bench.frames)
    report.seconds = time.perf_counter() - begun_s
    return report


if __name__ == "__main__":
    print(mutate(int(sys.argv[1]), int(sys.argv[2])))
