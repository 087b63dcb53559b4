"""What may stand in the table ``[dialects.kst9]`` of a unit file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from st_emulator.units.validation import Section


class Kst9Settings(Section):
    """``letter``: the unit's on its line. ``loader``: False skips the loader, as units before 1.2 had none.
    ``loader_ms``: without RUN the application starts after this time.
    """

    letter: Annotated[str, Field(pattern=r"^[A-Z]$")] = "A"
    loader: bool = True
    loader_ms: Annotated[int, Field(ge=250, le=60_000)] = 5000
