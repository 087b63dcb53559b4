"""A scenario's telecommands by the names of the commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...protocol.errors import LocalProtocolError
from ...protocol.nos3.messages import LAYOUTS, encode_command
from .settings import Nos3Settings


def encode_telecommand(settings: Nos3Settings, name: str, fields: Mapping[str, Any]) -> bytes:
    """A scenario's telecommand: a command of the unit's layout by its name; its one field is ``payload``, a
    number or a number as text (``"0x1F"``), 0 when it is left out.

    Raises:
        LocalProtocolError: names what is wrong and what is allowed.
    """
    layout = LAYOUTS[settings.layout]
    encode_command(layout, name)  # the name first: fields of another command say nothing
    for field in fields:
        if field != "payload":
            raise LocalProtocolError(name, field, fields[field], "payload alone")
    payload = fields.get("payload", 0)
    if isinstance(payload, str):
        try:
            payload = int(payload, 0)
        except ValueError:
            raise LocalProtocolError(name, "payload", payload, "a whole number") from None
    return encode_command(layout, name, payload)
