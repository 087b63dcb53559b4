"""A scenario's telecommands by the names of the messages."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from ...protocol.errors import LocalProtocolError
from ...protocol.sagitta.frames import MessageType, Request, request_body
from ...protocol.sagitta.layout import Kind, Layout
from ...protocol.sagitta.parameters import PARAMETER_TABLE
from ...protocol.sagitta.telemetry import ACTION_TABLE, TELEMETRY_TABLE, ActionId
from ...tai import tai_ns_from_utc
from .settings import SagittaSettings
from .unix_time import unix_us_from_tai

_NONE = Layout(())

#: Every telecommand by name: its type, id and arguments.
TELECOMMANDS: Mapping[str, tuple[MessageType, int, Layout]] = {
    **{
        f"set_{entry.name}": (MessageType.SET_PARAMETER, entry.id, entry.arguments)
        for entry in PARAMETER_TABLE
    },
    **{f"read_{entry.name}": (MessageType.READ_PARAMETER, entry.id, _NONE) for entry in PARAMETER_TABLE},
    **{
        f"request_{entry.name}": (MessageType.REQUEST_TELEMETRY, int(entry.id), _NONE)
        for entry in TELEMETRY_TABLE
    },
    **{entry.name: (MessageType.ACTION, int(entry.id), entry.arguments) for entry in ACTION_TABLE},
}


def encode_telecommand(settings: SagittaSettings, name: str, fields: Mapping[str, Any]) -> bytes:
    """The body of a telecommand; what is not among ``fields`` has its default.

    Set time takes ``utc`` (an ISO 8601 text or a date with its zone) in place of ``unix_us``.

    Raises:
        LocalProtocolError: names what is wrong and what is allowed.
    """
    found = TELECOMMANDS.get(name)
    if found is None:
        raise LocalProtocolError(name, "name", name, ", ".join(TELECOMMANDS))
    type_, id_, layout = found
    if (type_, id_) == (MessageType.ACTION, ActionId.SET_TIME):
        arguments = _time_arguments(settings, layout, fields)
    else:
        arguments = layout.pack(name, fields)
    return request_body(Request(type_, id_, arguments), settings.address)


def _time_arguments(settings: SagittaSettings, layout: Layout, fields: Mapping[str, Any]) -> bytes:
    values = dict(fields)
    for field in values:
        if field not in ("utc", "unix_us"):
            raise LocalProtocolError("set_time", field, values[field], "the fields utc or unix_us")
    if "utc" in values:
        moment = values.pop("utc")
        allowed = "a date and time with its zone, such as 2026-01-15T00:00:00Z"
        if not isinstance(moment, (str, datetime)) or "unix_us" in values:
            raise LocalProtocolError("set_time", "utc", moment, allowed)
        try:
            values["unix_us"] = unix_us_from_tai(tai_ns_from_utc(moment))
        except (ValueError, OverflowError) as error:
            raise LocalProtocolError("set_time", "utc", moment, allowed) from error
    if "unix_us" not in values:
        raise LocalProtocolError("set_time", "unix_us", None, f"{Kind.U64.limits[0]} to {Kind.U64.limits[1]}")
    arguments = layout.pack("set_time", values)
    if settings.set_time_words == "high_first":
        arguments = struct.pack("<2I", *reversed(struct.unpack("<2I", arguments)))
    return arguments
