"""Damaged traffic in quantity: nothing of it stops the unit, and the next good command is answered.

``python -m hil_tests.dialects.nos3.mutations 1000000`` from the root runs as many octets.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from dataclasses import dataclass

from hil_tests.dialects.nos3 import client
from hil_tests.dialects.nos3.bench import BYTE_NS, MS, Bench, make, sky, unit

CHECKED_EVERY = 2000  # octets
QUIET_MS = 250  # every answer to what was accepted by chance has left


@dataclass
class Report:
    """What was fed, and what came of it."""

    octets: int = 0
    pieces: int = 0
    well_formed: int = 0  # commands that the mutated octets held, by the tests' own search
    answered: int = 0  # good commands between, each with its echo and reply
    counted: int = 0  # by the unit's own counter


def _good(chance: random.Random) -> bytes:
    payload = chance.choice([0, 0, 1, 0xDEADBEEF, 0xBEEFDEAD, chance.getrandbits(32)])
    return client.raw_command(chance.choice([0, 1, 2, 2, 1, 3, chance.randrange(256)]), payload)


def _flip(octets: bytearray, chance: random.Random) -> None:
    for _ in range(chance.randint(1, 3)):
        octets[chance.randrange(len(octets))] ^= 1 << chance.randrange(8)


def _cut(octets: bytearray, chance: random.Random) -> None:
    start = chance.randrange(len(octets))
    del octets[start : start + chance.randint(1, 9)]


def _insert(octets: bytearray, chance: random.Random) -> None:
    place = chance.randrange(len(octets) + 1)
    octets[place:place] = chance.choice([chance.randbytes(chance.randint(1, 9)), b"\xde\xad", b"\xbe\xef"])


def _lengthen(octets: bytearray, chance: random.Random) -> None:
    octets *= chance.randint(2, 3)
    del octets[chance.randint(1, len(octets)) :]


def _swap(octets: bytearray, chance: random.Random) -> None:
    one, other = chance.randrange(len(octets)), chance.randrange(len(octets))
    octets[one], octets[other] = octets[other], octets[one]


def _replace(octets: bytearray, chance: random.Random) -> None:
    octets[:] = chance.randbytes(chance.randint(1, 30))


MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    _flip, _cut, _insert, _lengthen, _swap, _replace,
)  # fmt: skip


def _pieces(octets: bytes, chance: random.Random) -> list[bytes]:
    pieces = []
    while octets:
        size = chance.choice([1, 2, 3, 5, 8, 9, 13, 64])
        pieces.append(octets[:size])
        octets = octets[size:]
    return pieces


def _check(bench: Bench, report: Report, expected: list[bytes]) -> None:
    """All that was well-formed, and nothing else, was answered; and so is a good command."""
    bench.run(QUIET_MS)
    sent = bench.take()
    for command in expected:
        if command[2] > 2:
            continue
        assert sent.startswith(command), (sent[:22].hex(), command.hex())
        sent = sent[9 + (0, 8, 13)[command[2]] :]
    assert not sent, sent.hex()
    report.well_formed += len(expected)
    report.counted += sum(1 if command[2] > 2 else 2 for command in expected)
    assert bench.count() == (report.counted + 1) & 0xFFFFFFFF
    report.counted += 2
    report.answered += 1


def mutate(count: int, seed: int) -> Report:
    """Feed ``count`` octets of mutated good traffic to a running unit. Raises on the first thing wrong."""
    chance = random.Random(seed)
    bench = make(unit(), scenario=sky()).boot()
    report = Report()
    stream = bytearray()  # since the last check
    while report.octets < count:
        traffic = bytearray(b"".join(_good(chance) for _ in range(chance.randint(1, 3))))
        for _ in range(chance.randint(0, 2)):
            chance.choice(MUTATIONS)(traffic, chance)
            if not traffic:
                break
        for piece in _pieces(bytes(traffic), chance):
            bench.put(piece)
            report.pieces += 1
            # At once, as fast as the line, or with a pause; answers take longer than commands.
            bench.run(len(piece) * BYTE_NS / MS * chance.choice([0, 1, 1, 3, 4]))
        report.octets += len(traffic)
        stream += traffic
        bench.run(len(traffic) * 22 / 9 * BYTE_NS / MS)  # never more than can wait
        if len(stream) >= CHECKED_EVERY or report.octets >= count:
            # Octets left of half a command, closed so that the search of the next stretch begins anew.
            bench.put(b"\x00" * 9)
            _check(bench, report, [nine for _, nine in client.commands_in(bytes(stream) + b"\x00" * 9)])
            stream.clear()
    return report


if __name__ == "__main__":
    print(mutate(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1))
