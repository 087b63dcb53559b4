"""One module per PUS service: its telecommands and telemetry."""

from __future__ import annotations

from ..messages import ServiceDefinition
from . import (
    attitude,
    connection_test,
    events,
    functions,
    housekeeping,
    large_data,
    memory,
    parameters,
    time_management,
    verification,
)

SERVICES: tuple[ServiceDefinition, ...] = (
    verification.SERVICE,
    housekeeping.SERVICE,
    events.SERVICE,
    memory.SERVICE,
    functions.SERVICE,
    time_management.SERVICE,
    large_data.SERVICE,
    connection_test.SERVICE,
    parameters.SERVICE,
    attitude.SERVICE,
)
"""Every service of the interface."""
