"""My dialect as st-emulator finds it: ``[wire] dialect = "my_dialect.definition:DIALECT"``."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from st_emulator.device.star_tracker import StarTracker
from st_emulator.dialects.dialect import DialectDefinition, ScenarioSender, SerialWire
from st_emulator.dialects.line_sender import LineSender
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.units.profile import UnitProfile
from st_emulator.wire.can.wiring import CanWiring

from .dialect import MyDialect
from .exchange import exchange
from .messages import COMMANDS, encode
from .settings import MySettings


def _on_serial(device: StarTracker, wire: SerialWire, settings: MySettings) -> MyDialect:
    return MyDialect(device, wire, settings)


def _encode(
    profile: UnitProfile, settings: MySettings, name: str, fields: Mapping[str, Any], count: int
) -> bytes:
    """A scenario's telecommand; whatever is wrong with it is told with what is allowed."""
    layouts = {layout.name: layout for layout in COMMANDS}
    if name not in layouts:
        raise LocalProtocolError("telecommand", "name", name, ", ".join(layouts))
    wanted = layouts[name].fields
    if set(fields) != set(wanted):
        raise LocalProtocolError(name, "fields", sorted(fields), ", ".join(wanted) or "none")
    try:
        return encode(name, settings.address, dict(fields))
    except struct.error as error:
        raise LocalProtocolError(name, "fields", dict(fields), str(error)) from error


def _sender(profile: UnitProfile, settings: MySettings, wiring: CanWiring | None) -> ScenarioSender:
    return LineSender()


DIALECT = DialectDefinition(
    name="my_dialect",
    title="My unit's frames with a CRC on a serial line",
    settings=MySettings,
    on_serial=_on_serial,
    on_can=None,
    encode=_encode,
    sender=_sender,
    exchange=exchange,
    document=None,
)
