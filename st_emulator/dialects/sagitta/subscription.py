"""Subscribed telemetry: what is sent without being asked for, and when."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial

from ...clock import NS_PER_S
from ...device.star_tracker import StarTracker
from ...protocol.sagitta.telemetry import TELEMETRY, TelemetryId
from .settings import SagittaSettings


class FrameBudget:
    """Frames sent within the last second, whatever they are.

    Args:
        most: so many may be sent in a second.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._sent_ns: deque[int] = deque(maxlen=most)

    def reset(self) -> None:
        """None so far."""
        self._sent_ns.clear()

    def spend(self, now_ns: int) -> None:
        """One is sent now."""
        self._sent_ns.append(now_ns)

    def allows(self, now_ns: int) -> bool:
        """Whether one more stays within the budget."""
        return len(self._sent_ns) < self._most or now_ns - self._sent_ns[0] >= NS_PER_S


class Subscription:
    """The subscribed telemetry of a unit.

    Solutions and all else that tells of a frame come with each n-th frame (also while none is processed);
    the rest at its own period from the moment on at which it was subscribed to.

    Args:
        device: its frames and clock.
        settings: rates.
        send: sends telemetry now.
    """

    def __init__(
        self, device: StarTracker, settings: SagittaSettings, send: Callable[[TelemetryId], None]
    ) -> None:
        self._device = device
        self._settings = settings
        self._send = send
        self._ids: tuple[TelemetryId, ...] = ()
        self._set_count = 0  # what an earlier subscription scheduled is void

    def reset(self) -> None:
        """Nothing is subscribed to."""
        self._ids = ()
        self._set_count += 1

    def set(self, slots: list[int]) -> None:
        """Send this from now on: telemetry ids that there are, and 0 for none."""
        self.reset()
        counting = [TelemetryId(id_) for id_ in slots[: self._settings.subscription_slots] if id_]
        self._ids = tuple(dict.fromkeys(counting))
        for id_ in self._ids:
            if not TELEMETRY[id_].of_frame:
                self._again(id_, self._set_count)

    def _again(self, id_: TelemetryId, set_count: int) -> None:
        self._device.later(round(NS_PER_S / self._rate_hz(id_)), partial(self._due, id_, set_count))

    def _due(self, id_: TelemetryId, set_count: int) -> None:
        if set_count == self._set_count:
            self._again(id_, set_count)
            self._send(id_)

    def frame_told(self, frame_index: int) -> None:
        """The result of a frame is there, or there is none of it."""
        for id_ in self._ids:
            if TELEMETRY[id_].of_frame and frame_index % self.frames_between(id_) == 0:
                self._send(id_)

    def frames_between(self, id_: TelemetryId) -> int:
        """n: telemetry comes with each n-th frame, the fewest that keep its rate."""
        period_s = self._device.profile.frame_period_ns / NS_PER_S
        return max(1, math.ceil(1.0 / (self._rate_hz(id_) * period_s) - 1e-9))

    def _rate_hz(self, id_: TelemetryId) -> float:
        if id_ is TelemetryId.SOLUTION:
            return self._settings.solution_rate_hz
        if id_ is TelemetryId.TEMPERATURE:
            return self._settings.temperature_rate_hz
        return self._settings.other_rate_hz
