"""``sagitta`` among the dialects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...device.star_tracker import StarTracker
from ...protocol.sagitta.frames import frame_of
from ...units.profile import UnitProfile
from ...wire.can.wiring import CanWiring
from ..dialect import DialectDefinition, ScenarioSender, SerialWire
from ..line_sender import LineSender
from .dialect import SagittaDialect
from .document import interface_document
from .exchange import exchange
from .scenario_sender import encode_telecommand
from .settings import SagittaSettings


def _on_serial(device: StarTracker, wire: SerialWire, settings: SagittaSettings) -> SagittaDialect:
    return SagittaDialect(device, wire, settings)


def _encode(
    profile: UnitProfile, settings: SagittaSettings, name: str, fields: Mapping[str, Any], count: int
) -> bytes:
    return encode_telecommand(settings, name, fields)


def _sender(profile: UnitProfile, settings: SagittaSettings, wiring: CanWiring | None) -> ScenarioSender:
    return LineSender(frame_of)


SAGITTA = DialectDefinition(
    name="sagitta",
    title="frames with an XXH32 hash on a serial line, as flown with a public driver",
    settings=SagittaSettings,
    on_serial=_on_serial,
    on_can=None,
    encode=_encode,
    sender=_sender,
    exchange=exchange,
    document=interface_document,
)
