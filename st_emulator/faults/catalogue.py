"""The list of faults: the one place that names them all."""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Final

from pydantic import Field

from ..units.validation import Section
from . import bus, clock, line, memory, power, processor, sensor, telemetry
from .fault import FaultKind, FaultSettings

FAULTS: Final[dict[str, FaultKind]] = {
    kind.name: kind
    for module in (line, bus, telemetry, sensor, processor, memory, clock, power)
    for kind in module.KINDS
}

if TYPE_CHECKING:
    AnyFault = FaultSettings
else:
    AnyFault = Annotated[
        reduce(or_, (kind.settings for kind in FAULTS.values())), Field(discriminator="kind")
    ]


class FaultTable(Section):
    """One fault, to be told from the others by its ``kind``."""

    fault: AnyFault


def settings_table(table: FaultTable) -> FaultSettings:
    """The settings in it."""
    return table.fault
