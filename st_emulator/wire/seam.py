"""Where whole messages pass between the unit and its wire: the seam at which faults of the line enter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

Forward = Callable[[bytes], None]


class MessageSeam(Protocol):
    """Gets each message before it is framed or put on the line (``to_obc``), or when it has come in whole
    (``to_unit``), and calls ``forward`` with what goes on: at once or later, changed, many times or never.
    """

    def to_obc(self, message: bytes, forward: Forward) -> None: ...

    def to_unit(self, message: bytes, forward: Forward) -> None: ...


class _Plain:
    """Every message goes on as it is."""

    def to_obc(self, message: bytes, forward: Forward) -> None:
        forward(message)

    def to_unit(self, message: bytes, forward: Forward) -> None:
        forward(message)


PLAIN: Final[MessageSeam] = _Plain()
