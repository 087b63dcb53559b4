"""Where the time of a frame goes: a stopwatch around the stages of the chain, each without those inside."""

from __future__ import annotations

import contextlib
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import patch

from st_emulator.device import imaging, parameters
from st_emulator.dialects.pus.transmission import Transmitter
from st_emulator.firmware_model import firmware, frame_search, full_frame_search
from st_emulator.world.scene import RenderedFrame

STAGES: tuple[tuple[str, object, str], ...] = (
    ("render", RenderedFrame, "full"),
    ("render", RenderedFrame, "windows"),
    ("detect", full_frame_search, "detect"),
    ("detect", full_frame_search, "detect_clusters"),
    ("detect", firmware, "detect_in_windows"),
    ("identify", firmware, "plan_windows"),
    ("identify", firmware, "verify_by_pivot"),
    ("attitude", frame_search, "robust_q_method"),
    ("firmware_rest", imaging, "process_frame"),
    ("packet", Transmitter, "send"),
)


class Stopwatch:
    """Seconds by stage."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._inside: list[float] = []

    def around(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function``, with its time counted for ``stage``."""

        def timed(*arguments: Any, **named: Any) -> Any:
            begun = time.perf_counter()
            self._inside.append(0.0)
            try:
                return function(*arguments, **named)
            finally:
                elapsed = time.perf_counter() - begun
                self.seconds[stage] += elapsed - self._inside.pop()
                if self._inside:
                    self._inside[-1] += elapsed

        return timed


@contextlib.contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Time the stages of every unit that is made in the block."""
    watch = Stopwatch()
    make_configuration = parameters.firmware_configuration

    def configuration(*arguments: Any) -> Any:
        made = make_configuration(*arguments)
        object.__setattr__(made, "identify", watch.around("identify", made.identify))
        return made

    with contextlib.ExitStack() as stack:
        stack.enter_context(patch.object(parameters, "firmware_configuration", configuration))
        for stage, owner, name in STAGES:
            stack.enter_context(patch.object(owner, name, watch.around(stage, getattr(owner, name))))
        yield watch
