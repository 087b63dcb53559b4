"""The hash XXH32 (xxHash, Y. Collet: the specification of the algorithm, version 0.1.1)."""

from __future__ import annotations

import struct
from typing import Final

__all__ = ["xxh32"]

_MASK: Final = 0xFFFFFFFF
_PRIME_1: Final = 0x9E3779B1
_PRIME_2: Final = 0x85EBCA77
_PRIME_3: Final = 0xC2B2AE3D
_PRIME_4: Final = 0x27D4EB2F
_PRIME_5: Final = 0x165667B1
_STRIPE: Final = 16  # bytes, a lane of four for each accumulator


def _rotated(value: int, bits: int) -> int:
    """``value``, 32 bits, rotated left."""
    return (value << bits | value >> (32 - bits)) & _MASK


def xxh32(data: bytes, seed: int) -> int:
    """The 32-bit hash of ``data``; ``seed`` is taken modulo 2**32."""
    seed &= _MASK
    length = len(data)
    place = 0
    if length >= _STRIPE:
        lanes = [
            (seed + _PRIME_1 + _PRIME_2) & _MASK,
            (seed + _PRIME_2) & _MASK,
            seed,
            (seed - _PRIME_1) & _MASK,
        ]
        while place + _STRIPE <= length:
            words = struct.unpack_from("<4I", data, place)
            lanes = [
                _rotated((lane + word * _PRIME_2) & _MASK, 13) * _PRIME_1 & _MASK
                for lane, word in zip(lanes, words, strict=True)
            ]
            place += _STRIPE
        value = sum(_rotated(lane, bits) for lane, bits in zip(lanes, (1, 7, 12, 18), strict=True))
    else:
        value = seed + _PRIME_5
    value = (value + length) & _MASK
    while place + 4 <= length:
        (word,) = struct.unpack_from("<I", data, place)
        value = _rotated((value + word * _PRIME_3) & _MASK, 17) * _PRIME_4 & _MASK
        place += 4
    for octet in data[place:]:
        value = _rotated((value + octet * _PRIME_5) & _MASK, 11) * _PRIME_1 & _MASK
    value = (value ^ value >> 15) * _PRIME_2 & _MASK
    value = (value ^ value >> 13) * _PRIME_3 & _MASK
    return value ^ value >> 16
