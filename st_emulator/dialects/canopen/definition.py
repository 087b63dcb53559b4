"""CANopen as one dialect among several."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...device.star_tracker import StarTracker
from ...errors import ConfigurationError
from ...units.profile import UnitProfile
from ...wire.can.wiring import CanWiring
from ..dialect import CanWire, DialectDefinition, ScenarioSender
from .dialect import CanopenDialect
from .document import document
from .exchange import exchange
from .scenario_sender import CanopenSender
from .settings import CanopenSettings
from .telecommands import encode_named


def _on_can(device: StarTracker, wire: CanWire, settings: CanopenSettings) -> CanopenDialect:
    if wire.wiring.fd:
        raise ConfigurationError("dialect canopen: speaks classic CAN only; give the link without fd")
    return CanopenDialect(device, wire, settings)


def _encode(
    profile: UnitProfile, settings: CanopenSettings, name: str, fields: Mapping[str, Any], count: int
) -> bytes:
    return encode_named(settings.node, settings, name, fields)


def _sender(profile: UnitProfile, settings: CanopenSettings, wiring: CanWiring | None) -> ScenarioSender:
    wired = None if wiring is None else wiring.node
    return CanopenSender(settings.node, settings.node if wired is None else wired)


CANOPEN = DialectDefinition(
    name="canopen",
    title="CANopen (CiA 301) on CAN, as the star tracker card of OreSat 1",
    settings=CanopenSettings,
    on_serial=None,
    on_can=_on_can,
    encode=_encode,
    sender=_sender,
    exchange=exchange,
    document=document,
)
