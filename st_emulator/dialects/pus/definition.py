"""PUS as one dialect among several."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...device.star_tracker import StarTracker
from ...naming import resolve_fields
from ...protocol.framing import slip_encode
from ...protocol.pus.registry import encode_telecommand
from ...units.profile import UnitProfile
from ...units.validation import Section
from ...wire.can.wiring import CanWiring
from ..dialect import CanWire, DialectDefinition, ScenarioSender, SerialWire
from ..line_sender import LineSender
from .dialect import PusDialect
from .scenario_sender import SCENARIO_SOURCE_ID, CanSender


class PusSettings(Section):
    """None here: PUS has the sections ``[wire]`` and ``[can]`` of the unit file."""


def _on_serial(device: StarTracker, wire: SerialWire, settings: PusSettings) -> PusDialect:
    return PusDialect.on_serial(device, wire)


def _on_can(device: StarTracker, wire: CanWire, settings: PusSettings) -> PusDialect:
    return PusDialect.on_can(device, wire)


def _encode(
    profile: UnitProfile, settings: PusSettings, name: str, fields: Mapping[str, Any], count: int
) -> bytes:
    return encode_telecommand(
        name,
        resolve_fields(name, fields),
        apid=profile.apid,
        sequence_count=count & 0x3FFF,
        source_id=SCENARIO_SOURCE_ID,
    )


def _sender(profile: UnitProfile, settings: PusSettings, wiring: CanWiring | None) -> ScenarioSender:
    return LineSender(slip_encode) if wiring is None else CanSender(wiring.port_settings(profile.can))


PUS = DialectDefinition(
    name="pus",
    title="ECSS-E-ST-70-41C (PUS-C) packets over SLIP or ISO-TP, with cyclic frames on CAN",
    settings=PusSettings,
    on_serial=_on_serial,
    on_can=_on_can,
    encode=_encode,
    sender=_sender,
    exchange=None,
    document=None,
)
