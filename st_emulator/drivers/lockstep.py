"""Lockstep: time and truth are somebody else's. A unit goes on only when it is told how far.

Nothing here looks at the computer's clock. The same calls give the same bytes, as fast as the computer can.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..bench.emulator import Emulator
from ..bench.scenario import Scenario
from ..bench.supervision import Supervision
from ..device.imaging import FrameRecord
from ..firmware_model.modes import Mode
from ..firmware_model.reasons import Reason
from ..links import Link
from ..units.profile import UnitProfile
from ..world import quaternion
from ..world.sampled import BeyondTruthError, SampledTrajectory

ARCSEC_PER_RAD = 180.0 / np.pi * 3600.0
SENT_KEPT_BYTES = 1 << 22
"""Of what the unit sends so much waits for `Lockstep.take`; older bytes are lost, and counted."""

Condition = Callable[["Lockstep"], bool]


class LockstepError(Exception):
    """A step that cannot be made; one line that says why and what is allowed."""


class PausedError(LockstepError):
    """The unit is paused: first `Lockstep.resume`."""


@dataclass(frozen=True)
class LastFrame:
    """The last frame whose result counts.

    exposure_mid_ns: virtual time it is valid for; latency_ns: from there until its result counted.
    reasons: why there is no valid attitude, names. q_icrs_to_sensor: measured, [x, y, z, w], where valid.
    q_true_icrs_to_sensor: at mid-exposure; error_arcsec: measured against true about the sensor's axes x, y,
    z; both None where the truth is not known any more. rate_rad_s: measured, sensor axes, where known, also
    where no attitude is. spots, stars: found, identified. late_ns: how late the result was for the next
    frame. rate_covariance_rad2_s2: of the rate's error, row by row, nine values, where known.
    """

    frame_index: int
    exposure_mid_ns: int
    latency_ns: int
    valid: bool
    reasons: tuple[str, ...]
    q_icrs_to_sensor: tuple[float, ...] | None
    q_true_icrs_to_sensor: tuple[float, ...] | None
    error_arcsec: tuple[float, ...] | None
    rate_rad_s: tuple[float, ...] | None
    spots: int
    stars: int
    late_ns: int
    rate_covariance_rad2_s2: tuple[float, ...] | None = None


@dataclass(frozen=True)
class UnitTruth:
    """The true state of a unit, which its wire does not tell.

    t_ns: virtual time; tai_ns: the true date, TAI ns since 1958. mode: by name; valid: whether the last frame
    gave an attitude. onboard_tai_ns: what the unit's clock says; synchronised: whether it was set.
    q_icrs_to_sensor, rate_rad_s: now; None where no sample reaches so far, or with recorded frames.
    """

    t_ns: int
    tai_ns: int
    powered: bool
    mode: str
    valid: bool
    onboard_tai_ns: int
    synchronised: bool
    q_icrs_to_sensor: tuple[float, ...] | None
    rate_rad_s: tuple[float, ...] | None
    last_frame: LastFrame | None

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, texts, lists and dictionaries, fit for JSON."""
        return asdict(self)


class Lockstep:
    """A unit that is stepped.

    Args:
        emulator: the unit at any time of its life; what it sends is kept here for `take` from now on.
        link: a pty or a CAN bus beside: what the unit sends goes there as well, what an OBC has put there is
            taken at the beginning of each step, so at the time where the step begins.
    """

    def __init__(self, emulator: Emulator, link: Link | None = None) -> None:
        self.emulator = emulator
        self.supervision = Supervision(emulator)
        self.paused_because: str | None = None
        self.bytes_sent = 0
        self.bytes_received = 0
        self.bytes_lost = 0
        self._link = link
        self._sent: deque[tuple[int, bytes]] = deque()
        self._kept_bytes = 0
        emulator.transmit_to(self._transmitted)

    @classmethod
    def of(
        cls, profile: UnitProfile, scenario: Scenario | None = None, *, link: Link | None = None, **more: Any
    ) -> Lockstep:
        """A new unit whose truth comes by `set_attitude`; ``more``: further arguments of the emulator. With
        ``trajectory=None`` the truth is the scenario's.
        """
        more.setdefault("trajectory", SampledTrajectory())
        return cls(Emulator(profile, scenario, **more), link)

    @property
    def now_ns(self) -> int:
        """Virtual time."""
        return self.emulator.now_ns

    @property
    def truth_from_outside(self) -> bool:
        """Whether `set_attitude` has a meaning."""
        return isinstance(self.emulator.trajectory, SampledTrajectory)

    # -- truth in

    def set_attitude(
        self,
        t_ns: int,
        q_icrs_to_sensor: ArrayLike,
        rate_rad_s: ArrayLike | None = None,
        *,
        position_km: ArrayLike | None = None,
        velocity_km_s: ArrayLike | None = None,
        sun_direction: ArrayLike | None = None,
    ) -> None:
        """The truth at a virtual time, later than the one given before; may lie ahead of the present. See
        `st_emulator.world.sampled` for conventions and what holds in between.

        Raises:
            ValueError: a sample that does not fit, see `SampledTrajectory.add`.
            LockstepError: the truth is the scenario's.
        """
        trajectory = self.emulator.trajectory
        if not isinstance(trajectory, SampledTrajectory):
            raise LockstepError(
                "the truth of this unit is not given from outside; allowed is a unit that was started so"
            )
        trajectory.set_attitude(
            t_ns,
            q_icrs_to_sensor,
            rate_rad_s,
            position_km=position_km,
            velocity_km_s=velocity_km_s,
            sun_direction=sun_direction,
        )

    # -- time

    def step_to(self, t_ns: int) -> None:
        """Go on to a virtual time.

        Raises:
            BeyondTruthError: an exposure ends on the way whose truth is not given yet. The time then stands
                at that end; with the truth given, the same step goes on from there.
            LockstepError: the time is past, or the unit paused.
        """
        self._begin()
        if t_ns < self.now_ns:
            raise LockstepError(
                f"cannot step to {t_ns} ns: it is {self.now_ns} ns; allowed are times from there on"
            )
        self.emulator.advance(t_ns)

    def step_frame(self, count: int = 1) -> None:
        """Go on until ``count`` more frame periods have begun (a unit without power has no frames).

        Raises:
            BeyondTruthError, LockstepError: as `step_to`.
        """
        if count < 1:
            raise LockstepError(f"cannot step by {count} frames; allowed is a whole number from 1")
        self._begin()
        for _ in range(count):
            start_ns = self.emulator.device.imaging.next_start_ns
            if start_ns is None:
                raise LockstepError("cannot step by a frame: the unit has no power; allowed are times")
            self.emulator.advance(start_ns)

    def run_until(self, condition: Condition, limit_ns: int) -> bool:
        """Go on from event to event until ``condition`` of this holds, at most to ``limit_ns``; whether it
        holds. It is asked once before anything happens.

        Raises:
            BeyondTruthError, LockstepError: as `step_to`.
        """
        self._begin()
        while not condition(self):
            due_ns = self.emulator.next_event_ns()
            if due_ns is None or due_ns > limit_ns:
                self.emulator.advance(max(limit_ns, self.now_ns))
                return condition(self)
            self.emulator.advance(due_ns)
        return True

    def pause(self, because: str = "asked for") -> None:
        """No more steps until `resume`."""
        self.paused_because = because

    def resume(self) -> None:
        """Steps are allowed again."""
        self.paused_because = None

    def _begin(self) -> None:
        """A step begins: it is allowed, and what the OBC has put on the link came now."""
        if self.paused_because is not None:
            raise PausedError(
                f"the unit is paused at {self.now_ns} ns ({self.paused_because}); allowed is to resume it"
            )
        if self._link is not None:
            self.receive(self._link.read())

    # -- the wire

    def receive(self, data: bytes) -> None:
        """The OBC puts bytes on the unit's wire at the present time (on a CAN bus: records of frames)."""
        self.bytes_received += len(data)
        self.emulator.receive(data)

    def take_groups(self, most_bytes: int | None = None) -> list[tuple[int, bytes]]:
        """What the unit has sent since the last call: (virtual time at which it had left, bytes); with a
        limit the oldest, in whole groups, at least one.
        """
        groups: list[tuple[int, bytes]] = []
        taken = 0
        while self._sent and (
            most_bytes is None or not groups or taken + len(self._sent[0][1]) <= most_bytes
        ):
            groups.append(self._sent.popleft())
            taken += len(groups[-1][1])
        self._kept_bytes -= taken
        return groups

    def take(self) -> bytes:
        """The bytes alone."""
        return b"".join(data for _, data in self.take_groups())

    @property
    def waiting_bytes(self) -> int:
        """How many `take` would give."""
        return self._kept_bytes

    def _transmitted(self, data: bytes, t_ns: int) -> int | None:
        taken = None if self._link is None else self._link.write(data)
        self.bytes_sent += len(data)
        self._sent.append((t_ns, data))
        self._kept_bytes += len(data)
        while self._kept_bytes > SENT_KEPT_BYTES:
            lost = len(self._sent.popleft()[1])
            self._kept_bytes -= lost
            self.bytes_lost += lost
        return taken

    # -- faults

    def inject(self, fault: Mapping[str, Any]) -> int:
        """Put a fault in, as a table of a scenario's ``[[faults]]``; its number. ConfigurationError: it
        does not fit.
        """
        return self.supervision.inject(fault)

    def clear(self, number: int) -> None:
        """End a fault. Raises ConfigurationError for a number that there is not."""
        self.supervision.clear(number)

    def active_faults(self) -> list[dict[str, Any]]:
        """The faults in force: ``number`` and the settings, as in a scenario."""
        return self.supervision.active()

    def power(self, on: bool) -> None:
        """Let power come on, or cut it: what waits is lost, nothing is told."""
        self.supervision.power(on)

    # -- what is true

    def truth(self) -> UnitTruth:
        """The true state of the unit now."""
        emulator, device = self.emulator, self.emulator.device
        attitude = rate = None
        if emulator.scene is not None:
            with contextlib.suppress(BeyondTruthError):
                attitude = _floats(emulator.scene.trajectory.q_icrs_to_sensor(self.now_ns))
                rate = _floats(emulator.scene.trajectory.rate_sensor(self.now_ns))
        return UnitTruth(
            t_ns=self.now_ns,
            tai_ns=emulator.start_tai_ns + self.now_ns,
            powered=device.powered,
            mode=Mode(device.mode).name,
            valid=device.attitude_valid,
            onboard_tai_ns=device.time.tai_ns(self.now_ns),
            synchronised=device.time.synchronised,
            q_icrs_to_sensor=attitude,
            rate_rad_s=rate,
            last_frame=None if device.last_frame is None else self._last_frame(device.last_frame),
        )

    def truth_of_frame(self, frame_index: int) -> dict[str, Any]:
        """Time, true attitude and rate in the middle of a frame's exposure, as `Supervision.truth`.

        Raises:
            ConfigurationError: the unit has not processed such a frame, or that is long ago.
            BeyondTruthError: the truth of then is not known any more.
        """
        return self.supervision.truth(frame_index)

    def _last_frame(self, record: FrameRecord) -> LastFrame:
        result = record.result
        assert result is not None
        measured = true = error = None
        if result.valid:
            measured = _floats(result.q_icrs_to_sensor)
        scene = self.emulator.scene
        if scene is not None:
            with contextlib.suppress(BeyondTruthError):
                true = _floats(scene.trajectory.q_icrs_to_sensor(record.mid_exposure_ns))
        if measured is not None and true is not None:
            error = _floats(quaternion.error_rotation_vector(measured, true) * ARCSEC_PER_RAD)
        return LastFrame(
            frame_index=record.index,
            exposure_mid_ns=record.mid_exposure_ns,
            latency_ns=(record.due_ns or record.readout_end_ns) - record.mid_exposure_ns,
            valid=result.valid,
            reasons=tuple(item.name or "" for item in Reason if item in result.reasons),
            q_icrs_to_sensor=measured,
            q_true_icrs_to_sensor=true,
            error_arcsec=error,
            rate_rad_s=None if result.rate_rad_s is None else _floats(result.rate_rad_s),
            spots=result.spots_detected,
            stars=result.stars_identified,
            late_ns=record.late_ns,
            rate_covariance_rad2_s2=None
            if result.rate_rad_s is None or result.rate_covariance_rad2_s2 is None
            else _floats(result.rate_covariance_rad2_s2.ravel()),
        )

    def counters(self) -> dict[str, int]:
        """A snapshot of what is counted: by the device and its dialect, and of the bytes here."""
        counters, dialect = self.emulator.device.frame_counters, self.emulator.dialect
        return {
            **asdict(counters),
            "boot_count": self.emulator.device.parameters.boot_count,
            "messages_received": dialect.messages_received,
            "messages_sent": dialect.messages_sent,
            "bytes_received": self.bytes_received,
            "bytes_sent": self.bytes_sent,
            "bytes_lost": self.bytes_lost,
        }


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
