"""The self-test: memory, store, catalogue and sensor, a part at a time."""

from __future__ import annotations

import hashlib
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..clock import NS_PER_MS
from ..dialects.pus.reception import Request
from ..firmware_model.configuration import StarTables
from ..firmware_model.modes import ModeEvent
from ..protocol.pus.enumerations import EventId, FailureCode, FaultCause, SelfTest

if TYPE_CHECKING:
    from .star_tracker import StarTracker

STEPS = 4


class SelfTestRun:
    """The unit's self-test, running or done. ``result``: the parts that failed, 0 when all passed."""

    def __init__(self, unit: StarTracker) -> None:
        self._unit = unit
        self._tables_digest = digest_of(unit.tables)
        self.result = SelfTest(0)
        self._request: Request | None = None
        self._frame_seen = False

    @property
    def running(self) -> bool:
        return self._request is not None

    def reset(self) -> None:
        """The unit starts anew."""
        self._request = None
        self.result = SelfTest(0)

    def start(self, request: Request) -> None:
        """Test every part; report progress; back to STANDBY, or FAULT."""
        unit = self._unit
        unit.imaging.stop()
        unit.image_store.abort_capture()
        self._request = request
        self._frame_seen = False
        self.result = SelfTest(0)
        unit.follow(ModeEvent.COMMAND_SELF_TEST)
        request.started()
        unit.imaging.capture()
        step_ns = unit.profile.timing.self_test_ms * NS_PER_MS // STEPS
        for step in range(1, STEPS + 1):
            unit.later(step * step_ns, partial(self._step, request, step))

    def give_up(self) -> None:
        """It is aborted; its request fails."""
        if self._request is not None:
            self._unit.imaging.cancel_capture()
            self._request.failed(FailureCode.ABORTED)
            self._request = None

    def frame_captured(self) -> None:
        """The sensor gave the frame that was asked for."""
        self._frame_seen = True

    def _step(self, request: Request, step: int) -> None:
        if self._request is not request:
            return
        unit = self._unit
        failed = SelfTest(0)
        if step == 1 and not unit.memories.test_ram():
            failed = SelfTest.MEMORY
        elif step == 2 and unit.parameters.stored_fault() is not None:
            failed = SelfTest.PARAMETER_STORE
        elif step == 3 and digest_of(unit.tables) != self._tables_digest:
            failed = SelfTest.CATALOGUE
        elif step == 4 and not self._frame_seen:
            failed = SelfTest.SENSOR
        self.result |= failed
        if step < STEPS:
            request.progressed(step)
            return
        self._request = None
        unit.imaging.cancel_capture()
        unit.raise_event(EventId.SELF_TEST_COMPLETED, result=int(self.result))
        if self.result:
            request.failed(FailureCode.SELF_TEST_FAILED, int(self.result))
            unit.follow(ModeEvent.SELF_TEST_FAILED)
            unit.raise_event(EventId.FAULT_ENTERED, cause=int(FaultCause.SELF_TEST_FAILED))
        else:
            request.progressed(step)
            request.completed()
            unit.follow(ModeEvent.SELF_TEST_PASSED)


def digest_of(tables: StarTables) -> bytes:
    """Digest of the on-board star tables."""
    digest = hashlib.sha256()
    for array in tables.arrays():
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()
