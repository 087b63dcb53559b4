"""The KST-9 as st-emulator finds it: ``[wire] dialect = "kst9.definition:DIALECT"``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from st_emulator.device.star_tracker import StarTracker
from st_emulator.dialects.dialect import DialectDefinition, ScenarioSender, SerialWire
from st_emulator.dialects.line_sender import LineSender
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.units.profile import UnitProfile
from st_emulator.wire.can.wiring import CanWiring

from .dialect import Kst9
from .exchange import exchange
from .messages import COMMANDS, LONGEST_BODY, encode
from .settings import Kst9Settings


def _on_serial(device: StarTracker, wire: SerialWire, settings: Kst9Settings) -> Kst9:
    return Kst9(device, wire, settings)


def _encode(
    profile: UnitProfile, settings: Kst9Settings, name: str, fields: Mapping[str, Any], count: int
) -> bytes:
    """A scenario's telecommand; whatever is wrong with it is told with what is allowed."""
    if name not in COMMANDS:
        raise LocalProtocolError("telecommand", "name", name, ", ".join(COMMANDS))
    wanted = COMMANDS[name]
    if set(fields) != set(wanted):
        raise LocalProtocolError(name, "fields", sorted(fields), ", ".join(wanted) or "none")
    for field in wanted:
        text = str(fields[field])
        if not text.isascii() or not text.isprintable() or set(text) & set("$,*") or len(text) > LONGEST_BODY:
            raise LocalProtocolError(name, field, fields[field], "printable ASCII without $ , *")
    return encode(settings.letter, name, [fields[field] for field in wanted])


def _sender(profile: UnitProfile, settings: Kst9Settings, wiring: CanWiring | None) -> ScenarioSender:
    return LineSender()


DIALECT = DialectDefinition(
    name="kst9",
    title="KST-9: sentences with a checksum on a serial line, behind a loader",
    settings=Kst9Settings,
    on_serial=_on_serial,
    on_can=None,
    encode=_encode,
    sender=_sender,
    exchange=exchange,
    document=None,
)
