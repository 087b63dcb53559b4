"""The self-test: memories, store, catalogue and sensor, a part at a time."""

from __future__ import annotations

from ..firmware_model.causes import SelfTest
from .commands import Failure, Running
from .memories import Memories
from .parameters import Parameters

STEPS = 4


class SelfTestRun:
    """The unit's self-test, running or done.

    ``result``: the parts that failed, 0 when all passed; ``runs``: counts its beginnings and ends.
    """

    def __init__(self, memories: Memories, parameters: Parameters) -> None:
        self._memories = memories
        self._parameters = parameters
        self.result = SelfTest(0)
        self.runs = 0
        self._running: Running | None = None
        self._frame_seen = False

    @property
    def running(self) -> bool:
        return self._running is not None

    def reset(self) -> None:
        """The unit starts anew."""
        self._running = None
        self.result = SelfTest(0)

    def begin(self, running: Running) -> None:
        """It starts; nothing is tested yet."""
        self.runs += 1
        self._running = running
        self._frame_seen = False
        self.result = SelfTest(0)

    def give_up(self) -> None:
        """It is aborted."""
        self.runs += 1
        running, self._running = self._running, None
        if running is not None:
            running.failed(Failure.ABORTED)

    def frame_captured(self) -> None:
        """The sensor gave the frame that was asked for."""
        self._frame_seen = True

    def test(self, step: int) -> None:
        """Test part ``step`` of :data:`STEPS`."""
        failed = SelfTest(0)
        match step:
            case 1:
                if not self._memories.ram_works():
                    failed |= SelfTest.MEMORY
                if not self._memories.program_is_whole():
                    failed |= SelfTest.PROGRAM
            case 2 if self._parameters.stored_fault() is not None:
                failed = SelfTest.PARAMETER_STORE
            case 3 if not self._memories.catalogue_is_whole():
                failed = SelfTest.CATALOGUE
            case 4 if not self._frame_seen:
                failed = SelfTest.SENSOR
        self.result |= failed

    def end(self) -> None:
        """All parts are tested."""
        self._running = None
