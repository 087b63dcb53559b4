"""Whoever gave a command gives the next one as soon as it hears that the first is over: none is lost."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from st_emulator.device.commands import Acquire, CaptureImage, Command, Failure

from .conftest import Bench


class Again:
    """Gives the command anew at its end, ``times`` times, and writes down each end."""

    def __init__(self, bench: Bench, make: Callable[[], Command], times: int) -> None:
        self.bench, self.make, self.left = bench, make, times
        self.ends: list[str] = []

    def give(self) -> None:
        self.bench.emulator.device.check(self.make())
        self.bench.emulator.device.execute(self.make(), self)

    def started(self) -> None:
        pass

    def progressed(self, step: int) -> None:
        pass

    def _over(self, how: str) -> None:
        self.ends.append(how)
        if self.left:
            self.left -= 1
            self.give()

    def completed(self) -> None:
        self._over("completed")

    def failed(self, failure: Failure, data: int = 0) -> None:
        self._over(failure.name)


@pytest.mark.parametrize("kind", [CaptureImage, Acquire])
def test_again_when_it_is_completed(bench: Bench, kind: type[CaptureImage] | type[Acquire]) -> None:
    again = Again(bench, kind, 2)
    again.give()
    bench.run(4000)
    assert again.ends == ["completed"] * 3
    assert not bench.emulator.device.image_memory.busy
