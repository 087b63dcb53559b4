"""Bit layouts of the packet headers: one table each, which the codec and the interface document both walk.

Sources: CCSDS 133.0-B-2 clause 4.1.3 (primary header), ECSS-E-ST-70-41C clauses 7.4.3.1 and 7.4.4.1
(secondary headers; figure 7-9), CCSDS 301.0-B-4 clause 3.2 (CUC time). Bit 0 is the most significant.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Any

import construct

from ..errors import LocalProtocolError


@dataclass(frozen=True)
class HeaderField:
    """An unsigned number of ``bits`` bits; ``value`` says what stands there, where that is fixed."""

    name: str
    bits: int
    title: str
    value: str = ""


class HeaderLayout(construct.Construct):
    """A construct of bit fields without gaps, a whole number of bytes long: bytes <-> dict of ints."""

    def __init__(self, title: str, fields: tuple[HeaderField, ...]) -> None:
        super().__init__()
        self.title = title
        self.fields = fields
        total = sum(field.bits for field in fields)
        assert total % 8 == 0
        self.size_bytes = total // 8
        self._shifts: list[tuple[str, int, int]] = []
        for field in fields:
            total -= field.bits
            self._shifts.append((field.name, total, (1 << field.bits) - 1))

    def encode(self, **values: int) -> bytes:
        """The bytes of ``values``, one for each field; LocalProtocolError when one does not fit its bits."""
        number = 0
        for name, shift, highest in self._shifts:
            value = values[name]
            if type(value) is not int:
                try:
                    value = operator.index(value)
                except TypeError:
                    raise LocalProtocolError(self.title, name, value, f"0..{highest}") from None
            if not 0 <= value <= highest:
                raise LocalProtocolError(self.title, name, value, f"0..{highest}")
            number |= value << shift
        return number.to_bytes(self.size_bytes, "big")

    def decode(self, data: bytes) -> dict[str, int]:
        """The values of the fields in ``data``, which is as long as the header (else ValueError)."""
        if len(data) != self.size_bytes:
            raise ValueError(f"{self.title}: {self.size_bytes} bytes expected, got {len(data)}")
        number = int.from_bytes(data, "big")
        return {name: number >> shift & highest for name, shift, highest in self._shifts}

    def _parse(self, stream: Any, context: Any, path: str) -> dict[str, int]:
        return self.decode(construct.stream_read(stream, self.size_bytes, path))

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        stream.write(self.encode(**obj))
        return obj

    def _sizeof(self, context: Any, path: str) -> int:
        return self.size_bytes


_IDENTITY = (
    HeaderField("version", 3, "packet version number", "0"),
    HeaderField("packet_type", 1, "packet type", "0 telemetry, 1 telecommand"),
    HeaderField("secondary_header", 1, "secondary header flag", "1"),
    HeaderField("apid", 11, "application process identifier", "of the unit, 0..2046"),
    HeaderField("sequence_flags", 2, "sequence flags", "3 (unsegmented)"),
    HeaderField("sequence_count", 14, "packet sequence count", "up by 1 with each packet, modulo 16384"),
)

PRIMARY_HEADER = HeaderLayout(
    "packet primary header",
    (
        *_IDENTITY,
        HeaderField("data_length", 16, "packet data length", "bytes after the primary header, minus 1"),
    ),
)

REQUEST_ID_LAYOUT = HeaderLayout("request ID", _IDENTITY)
"""The first 4 bytes of a telecommand packet, as its verification reports repeat them (ECSS-E-ST-70-41C
8.1.2.1).
"""

TELECOMMAND_SECONDARY_HEADER = HeaderLayout(
    "telecommand secondary header",
    (
        HeaderField("pus_version", 4, "TC packet PUS version number", "2"),
        HeaderField("ack", 4, "acknowledgement flags", "8 acceptance, 4 start, 2 progress, 1 completion"),
        HeaderField("service", 8, "service type ID"),
        HeaderField("subservice", 8, "message subtype ID"),
        HeaderField("source_id", 16, "source ID", "of the sender, chosen by it"),
    ),
)

TELEMETRY_SECONDARY_HEADER = HeaderLayout(
    "telemetry secondary header",
    (
        HeaderField("pus_version", 4, "TM packet PUS version number", "2"),
        HeaderField("time_status", 4, "spacecraft time reference status", "see TimeStatus"),
        HeaderField("service", 8, "service type ID"),
        HeaderField("subservice", 8, "message subtype ID"),
        HeaderField("message_count", 16, "message type counter", "per service and subtype, modulo 65536"),
        HeaderField(
            "destination_id",
            16,
            "destination ID",
            "source ID of the telecommand that is answered, else the unit's default destination",
        ),
        HeaderField("time_coarse", 32, "packet time, CUC coarse", "TAI seconds since 1958-01-01"),
        HeaderField("time_fine", 24, "packet time, CUC fine", "2^-24 s"),
    ),
)
