"""The prose of the interface document: what no table of the registry says."""

from __future__ import annotations

INTRODUCTION = (
    "How an on-board computer (OBC) talks to the star tracker unit that this project emulates: bytes on",
    "the line, packets, messages, and what the unit does with them. Generated from the message registry;",
    "do not edit.",
    "",
    "Applicable documents:",
    "",
    "- ECSS-E-ST-70-41C (15 April 2016), packet utilization standard, PUS-C. Clauses are cited at each",
    "  message; where this interface departs from the standard, the message says so under *Tailoring*.",
    "- CCSDS 133.0-B-2, space packet protocol.",
    "- CCSDS 301.0-B-4, time code formats.",
    "- RFC 1055, serial line IP (SLIP), of which only the framing is used.",
    "",
)

LINE = (
    "A unit is on a serial line, as described here, or on a CAN bus, as described in the next chapter.",
    "",
    "Asynchronous serial line, 8 data bits, no parity, 1 stop bit, both directions at once. The baud rate",
    "is the unit's (see its file). There is no flow control.",
    "",
    "Each packet is one SLIP frame (RFC 1055):",
    "",
    "| Byte in the packet | On the line |",
    "|--------------------|-------------|",
    "| start of a frame   | C0 (END)    |",
    "| C0                 | DB DC       |",
    "| DB                 | DB DD       |",
    "| any other          | itself      |",
    "| end of a frame     | C0 (END)    |",
    "",
    "- END stands before and after each frame. Two ENDs with nothing in between are no frame and no error.",
    "- END always ends a frame, also right after DB. Whatever garbage comes between frames is a frame of its",
    "  own and is rejected as such; it never takes a frame that follows with it.",
    "- A frame that is longer than the receive buffer, or in which DB is followed by anything but DC or DD,",
    "  is thrown away up to its END.",
    "- Bytes may come in any rhythm; there is no time-out between them.",
    "",
)

CONVENTIONS = (
    "**Numbers** are big-endian. **Byte** in the tables counts from 0 at the first byte of the packet. Bit 0",
    "is the most significant of its byte. Behind contents of varying length a place is written as a sum:",
    "`18+n` is 18 bytes plus the length n; `12+3i` is the place in item i, counted from 0; `item+2` counts",
    "from the start of an item.",
    "",
    "**Sensor frame S**: +Z is the boresight, pointing out of the camera; +X points to increasing columns",
    "and +Y to increasing rows of the image; right-handed. Pixel coordinates are x = column, y = row,",
    "counted from 0; whole numbers are pixel centres.",
    "",
    "**Attitude** `q_icrs_to_sensor` = [x, y, z, w], scalar last, of unit length, w >= 0. It turns",
    "components, not vectors: a direction with components v_ICRS in the ICRS has in the sensor frame the",
    "components",
    "",
    "```",
    "v_S = A(q) v_ICRS,    A(q) = (w^2 - v.v) I + 2 v v^T - 2 w [v x],    v = (x, y, z)",
    "```",
    "",
    "where [v x] is the matrix of the cross product. The boresight in the ICRS is the third row of A(q).",
    "The identity looks at the celestial north pole, its +X to right ascension 0.",
    "",
    "**Covariance** is that of the small rotation vector (rad, components in the sensor frame) by which the",
    "measured sensor frame is turned against the true one: xx and yy are about the axes across the",
    "boresight, zz is the roll about it.",
    "",
    "**Rate** is the angular velocity of the sensor frame relative to the ICRS, components in the sensor",
    "frame. Its covariance is that of the error of these components, in (rad/s)^2; 1 sigma about an axis is",
    "the square root of the element on the diagonal. A rate, and a covariance, that is not known is sent as",
    "0 with its flag 0: look at the flag, not at the number.",
    "",
    "**Time** is TAI counted from 1958-01-01 00:00:00 TAI, in the CCSDS unsegmented code (CUC, CCSDS",
    "301.0-B-4 clause 3.2) with 4 bytes of seconds and 3 bytes of 2^-24 s. The P-field, which would be 1F,",
    "is not transmitted. Before the time has been set it counts from the unit's start (see",
    "[TimeStatus](#timestatus)).",
    "",
    "**Reserved** values are sent as 0.",
    "",
)

TYPES = (
    ("u8, u16, u32", "1, 2, 4", "unsigned integer"),
    ("i16, i32", "2, 4", "signed integer, two's complement"),
    ("f32, f64", "4, 8", "IEEE 754 binary floating point"),
    ("CUC", "7", "time: u32 seconds, then 24 bits of 2^-24 s"),
    ("request ID", "4", "see [there](#request-id)"),
    ("octets", "varies", "bytes as they are"),
)

PACKETS = (
    "Every packet is a primary header, a secondary header, application data (telecommand) or source data",
    "(telemetry) and 2 bytes of packet error control:",
    "",
    "CRC-16 with polynomial x^16 + x^12 + x^5 + 1 (1021), preset to FFFF, most significant bit first,",
    "neither reflected nor inverted, over all bytes of the packet before it (ECSS-E-ST-70-41C annex B).",
    "Over a whole good packet the CRC is 0. Check values: `00 00` gives 1D0F, `AB CD EF 01` gives 04A2.",
    "",
)

RECEPTION = (
    "What the unit receives is checked in the order of this table; the first check that fails decides. A",
    "rejected frame changes nothing but the counters of housekeeping structure LINK, and the frames after it",
    "are not touched. When framing, length, CRC or header are wrong, the sender cannot be known and an event",
    "tells it; otherwise a failure report goes to the source of the telecommand.",
    "",
)

AFTER_RECEPTION = (
    "After these come the mode, identifiers and ranges, and at last what the state of the unit decides",
    "(addresses, checksums, a running request), which TM[1,2] tells too. A gap in the sequence count of a",
    "source, seen in telecommands that pass reasons 1 to 11, is told by event TC_SEQUENCE_GAP_DETECTED; the",
    "telecommand is executed all the same. A count of 0 is the restart of a source, not a gap.",
    "",
)

VERIFICATION = (
    "| Stage      | Success | Failure  | Success is reported when |",
    "|------------|---------|----------|--------------------------|",
    "| routing    |         | TM[1,10] |                          |",
    "| acceptance | TM[1,1] | TM[1,2]  | ack flag 8 is set        |",
    "| start      | TM[1,3] | TM[1,4]  | ack flag 4 is set        |",
    "| progress   | TM[1,5] | TM[1,6]  | ack flag 2 is set        |",
    "| completion | TM[1,7] | TM[1,8]  | ack flag 1 is set        |",
    "",
    "Failures are always reported. Every accepted telecommand ends in exactly one of TM[1,4], TM[1,7] (if",
    "asked for) and TM[1,8]; the function RESET is the exception. Telecommands that are done at once report",
    "no start. Reports go to the source of the telecommand: its source ID is their destination ID.",
    "",
)

NOT_SAID = "Not stated in this edition."
