"""What may stand in the table ``[dialects.my_dialect]`` of a unit file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from st_emulator.units.validation import Section


class MySettings(Section):
    """``address``: of the unit on its line. ``attitude_every``: after a start an attitude comes every so many
    frames; 0: never. ``gap_ms``: a frame whose octets stop for so long is given up.
    """

    address: Annotated[int, Field(ge=1, le=254)] = 7
    attitude_every: Annotated[int, Field(ge=0, le=255)] = 1
    gap_ms: Annotated[int, Field(ge=1, le=1000)] = 10
