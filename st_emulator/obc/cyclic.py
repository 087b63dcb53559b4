"""The unit's cyclic frames as an OBC keeps them, and the attitudes that they make up.

A frame of the camera is told in several CAN frames that share an 8-bit counter. Any of them may be lost,
and 256 frames later the counter is the same again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..protocol.pus.enumerations import Reason
from ..protocol.pus.packets import CucTime
from .attitude import pointing_deg
from .transport import CyclicReceived

KEPT_FRAMES = 50_000
KEPT_ATTITUDES = 20_000  # 80 minutes at 4 Hz
HALVES = ("attitude_1", "attitude_2")
PARTS = (*HALVES, "rates", "status", "mid_exposure_time")
JOINING_NS = 1_000_000_000
"""Parts of one frame come together. A counter comes round after 2.56 s or more (frame_period_ms is 10 ms or
more), so that parts that came within this time of each other are of one frame.
"""


@dataclass(frozen=True)
class CyclicFrame:
    """A cyclic frame: its number in the order of arrival (telemetry packets counted in), its physical values,
    its data and the OBC's time of its reception.
    """

    number: int
    name: str
    values: Mapping[str, Any]
    raw: bytes
    time_ns: int


@dataclass(frozen=True)
class CyclicAttitude:
    """The attitude of one frame of the camera, from both of its halves.

    q_icrs_to_sensor: float64[4], x y z w, in steps of 2^-27. received_ns: when the later half came. status,
    rates, mid_exposure: the values of the other frames of this counter, None where none came (yet).
    """

    counter: int
    q_icrs_to_sensor: NDArray[np.float64]
    received_ns: int
    status: Mapping[str, Any] | None
    rates: Mapping[str, Any] | None
    mid_exposure: Mapping[str, Any] | None

    @property
    def pointing_deg(self) -> tuple[float, float, float]:
        """Right ascension, declination and roll of the boresight, degrees."""
        return pointing_deg(self.q_icrs_to_sensor)

    @property
    def valid(self) -> bool | None:
        """Whether the unit says that the attitude is valid; None as long as it has not said."""
        return None if self.status is None else bool(self.status["valid"])

    @property
    def reasons(self) -> Reason | None:
        """Why it is not valid; None as long as the unit has not said."""
        return None if self.status is None else Reason(self.status["reasons"])

    @property
    def time(self) -> CucTime | None:
        """On-board time of the middle of the exposure."""
        return None if self.mid_exposure is None else cuc_time(self.mid_exposure)

    @property
    def rate_rad_s(self) -> NDArray[np.float64] | None:
        """Rate of the sensor relative to ICRS in sensor axes; None: not said, or not valid."""
        if self.rates is None or not self.rates["rate_valid"]:
            return None
        return np.array([self.rates[f"rate_{axis}"] for axis in "xyz"], dtype=np.float64)


def cuc_time(values: Mapping[str, Any]) -> CucTime:
    """The time of a frame that carries seconds and a fraction."""
    return CucTime(int(values["seconds"]), round(values["fraction"] * (1 << 24)))


class _CameraFrame:
    """The parts of one frame that have come: values and reception time by name."""

    def __init__(self, counter: int, first_ns: int) -> None:
        self.counter = counter
        self.first_ns = first_ns
        self.parts: dict[str, tuple[Mapping[str, Any], int]] = {}

    def attitude(self) -> CyclicAttitude | None:
        """None without both halves."""
        if any(name not in self.parts for name in HALVES):
            return None
        halves = [self.parts[name] for name in HALVES]
        values = {**halves[0][0], **halves[1][0]}
        others = {name: part[0] for name, part in self.parts.items()}
        return CyclicAttitude(
            counter=self.counter,
            q_icrs_to_sensor=np.array([values[f"q_{axis}"] for axis in "xyzw"], dtype=np.float64),
            received_ns=max(time_ns for _, time_ns in halves),
            status=others.get("status"),
            rates=others.get("rates"),
            mid_exposure=others.get("mid_exposure_time"),
        )


class AttitudeJoiner:
    """Puts the parts of each frame together, in whatever order they come and whichever are missing.

    Parts belong together when their counters agree and they came within JOINING_NS of the first of them.
    """

    def __init__(self) -> None:
        self._frames: deque[_CameraFrame] = deque(maxlen=KEPT_ATTITUDES)
        self._open: dict[int, _CameraFrame] = {}
        self._boot_count: int | None = None

    def take(self, name: str, values: Mapping[str, Any], now_ns: int) -> None:
        """A cyclic frame has come."""
        if name == "heartbeat":
            if self._boot_count not in (None, values["boot_count"]):
                self.restart()
            self._boot_count = values["boot_count"]
        if name not in PARTS:
            return
        counter = values["counter"]
        frame = self._open.get(counter)
        if frame is not None and now_ns - frame.first_ns <= JOINING_NS:
            known = frame.parts.get(name)
            if known is not None and known[0] == values:
                return  # repeated
            if known is not None:
                frame = None
        else:
            frame = None
        if frame is None:
            frame = self._open[counter] = _CameraFrame(counter, now_ns)
            self._frames.append(frame)
        frame.parts[name] = (values, now_ns)

    def restart(self) -> None:
        """The unit has started again and counts anew: what comes belongs to nothing that came."""
        self._open.clear()

    def attitudes(self) -> list[CyclicAttitude]:
        """Every attitude whose halves both came, by the first part's arrival."""
        joined = (frame.attitude() for frame in self._frames)
        return [attitude for attitude in joined if attitude is not None]


class CyclicLog:
    """Every cyclic frame of the unit: the latest by name, the last ones in order, the attitudes."""

    def __init__(self) -> None:
        self.latest: dict[str, CyclicFrame] = {}
        self.attitudes = AttitudeJoiner()
        self._frames: deque[CyclicFrame] = deque(maxlen=KEPT_FRAMES)

    def take(self, number: int, event: CyclicReceived) -> None:
        """A frame has come, as number `number` of all that came."""
        frame = CyclicFrame(number, event.name, event.values, event.raw, event.time_ns)
        self.latest[frame.name] = frame
        self._frames.append(frame)
        self.attitudes.take(frame.name, frame.values, frame.time_ns)

    def since(self, mark: int) -> list[CyclicFrame]:
        """Frames from the number `mark` on, in order."""
        return list(self._backwards(mark))[::-1]

    def _backwards(self, mark: int) -> Iterator[CyclicFrame]:
        for frame in reversed(self._frames):
            if frame.number < mark:
                return
            yield frame
