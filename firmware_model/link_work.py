"""Work of the link: packets built and taken in, images kept for download; ``arm/telemetry.c`` and its like.

Counted for SLIP on a serial line. ASSUMED: packets cut into CAN frames cost as much.
"""

from __future__ import annotations

from .work import Work

__all__ = ["kept_image_work", "line_work", "packet_work", "round_work", "telecommand_work"]


def round_work(sent: Work, received: Work) -> Work:
    """All that the link asked for between two frames: ``sent`` for packets, ``received`` for telecommands."""
    work = sent + received
    if any(sent.counts.values()):
        work.add("sending_rounds")
    if any(received.counts.values()):
        work.add("receiving_rounds")
    return work


def packet_work(packet_bytes: int, copied_bytes: int = 0) -> Work:
    """A telemetry packet of so many bytes, of which so many are a copy of an image or of memory."""
    return Work(
        {
            "telemetry_bytes": packet_bytes - copied_bytes,
            "image_bytes": copied_bytes,
            "crc_bytes": packet_bytes,
        }
    )


def line_work(line_bytes: int) -> Work:
    """So many bytes of the line, escapes and all, received."""
    return Work({"telecommand_bytes": line_bytes})


def telecommand_work(checked_bytes: int) -> Work:
    """The headers of a received packet checked, and the error control over so many bytes (0 where its length
    is wrong already).
    """
    work = Work({"telecommands": 1})
    if checked_bytes:
        work.add("crc_bytes", checked_bytes)
    return work


def kept_image_work(pixels: int) -> Work:
    """The CRC of an image that is kept for download."""
    return Work({"image_crc_pixels": pixels})
