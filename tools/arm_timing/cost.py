"""What a run on the simulated processor cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


def _added(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    return {key: one.get(key, 0) + other.get(key, 0) for key in (*one, *(k for k in other if k not in one))}


def _added_sizes(one: Mapping[int, int], other: Mapping[int, int]) -> dict[int, int]:
    return {key: one.get(key, 0) + other.get(key, 0) for key in (*one, *(k for k in other if k not in one))}


@dataclass(frozen=True)
class Cost:
    """Counts of one call, or of several added up.

    ``core_cycles`` is what the core takes when every access hits: ``interlock_cycles`` are among them. Fills
    and write-backs are of lines of 32 bytes, by cache size in KiB (the instruction and the data cache each
    have that size). ``fetches`` are instruction words, ``data_accesses`` data words, halfwords or bytes: what
    goes to memory with the caches off. ``class_counts`` are instructions by class.
    """

    instructions: int = 0
    core_cycles: int = 0
    fetch_fills: Mapping[int, int] = field(default_factory=dict)
    data_fills: Mapping[int, int] = field(default_factory=dict)
    data_accesses: int = 0
    fetches: int = 0
    write_backs: Mapping[int, int] = field(default_factory=dict)
    class_counts: Mapping[str, int] = field(default_factory=dict)
    interlock_cycles: int = 0

    def __add__(self, other: Cost) -> Cost:
        return Cost(
            self.instructions + other.instructions,
            self.core_cycles + other.core_cycles,
            _added_sizes(self.fetch_fills, other.fetch_fills),
            _added_sizes(self.data_fills, other.data_fills),
            self.data_accesses + other.data_accesses,
            self.fetches + other.fetches,
            _added_sizes(self.write_backs, other.write_backs),
            _added(self.class_counts, other.class_counts),
            self.interlock_cycles + other.interlock_cycles,
        )

    def line_fills(self, cache_kib: int = 32) -> int:
        """Lines filled in both caches of a size that was simulated; KeyError for another."""
        return self.fetch_fills[cache_kib] + self.data_fills[cache_kib]

    def memory_cycles(self, line_fill_cycles: float, cache_kib: int = 32) -> float:
        """CPU cycles spent waiting for memory, beyond the core's.

        ``line_fill_cycles`` is the time of one line fill; with ``cache_kib=0``, caches off, that of one
        access.
        """
        accesses = self.line_fills(cache_kib) if cache_kib else self.fetches + self.data_accesses
        return accesses * line_fill_cycles


@dataclass(frozen=True)
class Call:
    """What a called function returned, and its cost."""

    result: int  # r0, as an unsigned word
    result_pair: float  # r0 and r1 as a double
    cost: Cost


@dataclass(frozen=True)
class Run:
    """How a whole program ended, and its cost."""

    result: int  # r0, as an unsigned word
    exit_code: int | None  # None: it returned
    cost: Cost
