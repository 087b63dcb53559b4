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


def telecommand_work(packet: bytes) -> Work:
    """The headers of a received packet checked, and its error control where the length is right."""
    work = Work({"telecommands": 1})
    if len(packet) == int.from_bytes(packet[4:6], "big") + 7:  # the field is one less than what follows it
        work.add("crc_bytes", len(packet))
    return work


def kept_image_work(pixels: int) -> Work:
    """The CRC of an image that is kept for download."""
    return Work({"image_crc_pixels": pixels})
