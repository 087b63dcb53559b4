"""ST[17] test: are you there."""

from __future__ import annotations

from functools import partial

from ..serving import ANY, Execute, Served
from ..verification import Request


class ConnectionTest:
    """Answers pings."""

    def ping(self, request: Request) -> Execute:
        return partial(self._answer, request)

    @staticmethod
    def _answer(request: Request) -> None:
        request.answer("pong", {})
        request.completed()


SERVED = {"ping": Served(ANY, ConnectionTest.ping)}
