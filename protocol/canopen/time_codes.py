"""The two times of the card in 8 octets, little-endian, both of the Unix epoch (oresat-olaf, ECSS resource).

``scet``: u32 seconds, u24 microseconds, one octet of 0. ``utc``: u16 days, u32 milliseconds of the day, u16
microseconds of the millisecond. As whole numbers of 64 bits they are what the objects 2010h and 2011h hold.
"""

from __future__ import annotations

US_PER_S = 1_000_000
US_PER_MS = 1_000
MS_PER_DAY = 86_400_000


def scet_of(unix_us: int) -> int:
    """Microseconds since 1970 as the value of 2010h; the seconds turn over behind 32 bits."""
    seconds, microseconds = divmod(unix_us, US_PER_S)
    return (seconds & 0xFFFF_FFFF) | microseconds << 32


def unix_us_of_scet(value: int) -> int | None:
    """Microseconds since 1970; None: a second has no so many of them. The last octet is not looked at."""
    microseconds = value >> 32 & 0xFF_FFFF
    return None if microseconds >= US_PER_S else (value & 0xFFFF_FFFF) * US_PER_S + microseconds


def utc_of(unix_us: int) -> int:
    """Microseconds since 1970 as the value of 2011h; the days turn over behind 16 bits."""
    milliseconds, microseconds = divmod(unix_us, US_PER_MS)
    days, milliseconds = divmod(milliseconds, MS_PER_DAY)
    return (days & 0xFFFF) | milliseconds << 16 | microseconds << 48


def unix_us_of_utc(value: int) -> int | None:
    """Microseconds since 1970; None: a day has no so many milliseconds, or a millisecond microseconds."""
    days, milliseconds, microseconds = value & 0xFFFF, value >> 16 & 0xFFFF_FFFF, value >> 48
    if milliseconds >= MS_PER_DAY or microseconds >= US_PER_MS:
        return None
    return (days * MS_PER_DAY + milliseconds) * US_PER_MS + microseconds
