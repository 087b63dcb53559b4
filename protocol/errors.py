"""Errors of the wire protocol.

Malformed input is a value (:class:`~st_emulator.protocol.pus.packets.Malformed`), never an exception;
these are for code that builds nonsense and for peers whose well-formed packets make no sense.
"""

from __future__ import annotations

from typing import Any


class ProtocolError(Exception):
    """Base of every error of the protocol."""


class LocalProtocolError(ProtocolError):
    """We were asked to build something that the protocol cannot carry.

    ``message`` is the name of the message (or header) being built, ``field`` the path of the field in it
    (``settings[0].value``), ``value`` what was given and ``allowed`` what may stand there.
    """

    def __init__(self, message: str, field: str, value: Any, allowed: str) -> None:
        self.message = message
        self.field = field
        self.value = value
        self.allowed = allowed
        shown = repr(value)
        if len(shown) > 80:
            shown = shown[:77] + "..."
        super().__init__(f"{message}: {field} = {shown}; allowed: {allowed}")


class RemoteProtocolError(ProtocolError):
    """The other side sent a valid packet that cannot be right in this place (for example a report nobody
    asked for).
    """
