"""nos3 as one dialect among several."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...device.star_tracker import StarTracker
from ...units.profile import UnitProfile
from ...wire.can.wiring import CanWiring
from ..dialect import DialectDefinition, ScenarioSender, SerialWire
from ..line_sender import LineSender
from .dialect import Nos3Dialect
from .document import interface_document
from .exchange import exchange
from .scenario_sender import encode_telecommand
from .settings import Nos3Settings


def _on_serial(device: StarTracker, wire: SerialWire, settings: Nos3Settings) -> Nos3Dialect:
    return Nos3Dialect(device, wire, settings)


def _encode(
    profile: UnitProfile, settings: Nos3Settings, name: str, fields: Mapping[str, Any], count: int
) -> bytes:
    return encode_telecommand(settings, name, fields)


def _sender(profile: UnitProfile, settings: Nos3Settings, wiring: CanWiring | None) -> ScenarioSender:
    return LineSender()


NOS3 = DialectDefinition(
    name="nos3",
    title="NASA's generic star tracker (NOS3): nine-octet commands, echo and reply on a serial line",
    settings=Nos3Settings,
    on_serial=_on_serial,
    on_can=None,
    encode=_encode,
    sender=_sender,
    exchange=exchange,
    document=interface_document,
)
