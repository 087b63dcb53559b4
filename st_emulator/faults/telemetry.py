"""Faults of the telemetry: packets that are well formed and wrong.

Most stand where the device tells of a frame, so that every dialect says what they make of it, and the unit
itself goes on undisturbed. What a dialect does not take from there is changed in its messages.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, Final, Literal

from pydantic import Field

from ..clock import NS_PER_S, NS_PER_US
from ..device.commands import Quaternion
from ..device.imaging import FrameRecord
from ..device.reports import AttitudeReady
from ..wire.seam import Forward
from . import telemetry_octets as octets_of
from .fault import AtAttitude, AtMessages, FaultKind, FaultSettings, Reach, SettingsT

Axis = Literal["x", "y", "z"]


@dataclasses.dataclass
class StampedRecord(FrameRecord):
    """A frame that is said to have been exposed at another time, ``stamp_ns``."""

    stamp_ns: int = 0

    @property
    def mid_exposure_ns(self) -> int:
        return self.stamp_ns


def stamped(record: FrameRecord, stamp_ns: int) -> StampedRecord:
    values = {field.name: getattr(record, field.name) for field in dataclasses.fields(FrameRecord)}
    return StampedRecord(**values, stamp_ns=stamp_ns)


class FrozenAttitudeSettings(FaultSettings):
    kind: Literal["telemetry.frozen_attitude"]


class FrozenAttitude(AtAttitude[FrozenAttitudeSettings]):
    """What the first processed frame gave is told of all those behind it."""

    def __init__(self, settings: FrozenAttitudeSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._frozen: AttitudeReady | None = None

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        frozen = self._frozen
        if frozen is None:
            if report.record.result is not None:
                self._frozen = report
            return report
        if not self.strikes():
            return report
        shown = frozen.record
        record = dataclasses.replace(
            report.record,
            exposure_ns=shown.exposure_ns,
            acquisition=shown.acquisition,
            pixels=shown.pixels,
            result=shown.result,
            work=shown.work,
            cycles=shown.cycles,
            late_ns=shown.late_ns,
            dropped_before=shown.dropped_before,
            drop_cause=shown.drop_cause,
        )
        return AttitudeReady(record, frozen.reasons, frozen.q_icrs_to_sensor)


class FrozenCounterSettings(FaultSettings):
    kind: Literal["telemetry.frozen_counter"]


class FrozenCounter(AtAttitude[FrozenCounterSettings]):
    def __init__(self, settings: FrozenCounterSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._index: int | None = None

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        if self._index is None:
            self._index = report.record.index
        if not self.strikes():
            return report
        return dataclasses.replace(report, record=dataclasses.replace(report.record, index=self._index))


class Stamping(AtAttitude[SettingsT], AtMessages[SettingsT]):
    """Tells another measurement time: in what the device tells, and with sagitta in its solutions, whose time
    is that of sending.
    """

    def shift_ns(self, true_ns: int) -> int:
        """By how much the time of a frame that is struck is another. ``true_ns``: when it was measured."""
        raise NotImplementedError

    @property
    def _in_messages(self) -> bool:
        return self.reach.profile.wire.dialect == "sagitta"

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        if self._in_messages or not self.strikes():
            return report
        true_ns = report.record.mid_exposure_ns
        record = stamped(report.record, true_ns + self.shift_ns(true_ns))
        return dataclasses.replace(report, record=record)

    def message(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        if to_obc and self._in_messages and self.strikes():
            shift_us = self.shift_ns(self.reach.clock.now_ns) // NS_PER_US
            message = octets_of.with_sagitta_time(message, shift_us)
        forward(message)


class StaleTimeSettings(FaultSettings):
    kind: Literal["telemetry.stale_time"]
    lag_s: Annotated[
        float | None, Field(ge=0, le=1_000_000, description="none: the time stands from the fault's begin on")
    ] = None


class StaleTime(Stamping[StaleTimeSettings]):
    def __init__(self, settings: StaleTimeSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._stands_ns: int | None = None

    def shift_ns(self, true_ns: int) -> int:
        lag_s = self.settings.lag_s
        if lag_s is not None:
            return -round(lag_s * NS_PER_S)
        if self._stands_ns is None:
            self._stands_ns = true_ns
        return self._stands_ns - true_ns


class JumpingTimeSettings(FaultSettings):
    kind: Literal["telemetry.jumping_time"]
    most_s: Annotated[
        float, Field(gt=0, le=1_000_000, description="each jump is at most so far, either way")
    ] = 1.0


class JumpingTime(Stamping[JumpingTimeSettings]):
    def shift_ns(self, true_ns: int) -> int:
        most_ns = round(self.settings.most_s * NS_PER_S)
        return self.random.randint(-most_ns, most_ns)


class StuckSequenceCountSettings(FaultSettings):
    kind: Literal["telemetry.stuck_sequence_count"]


class StuckSequenceCount(AtMessages[StuckSequenceCountSettings]):
    """Each message has the count of the first one."""

    def __init__(self, settings: StuckSequenceCountSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._count: int | None = None
        sagitta = reach.profile.wire.dialect == "sagitta"
        self._count_of = octets_of.sagitta_counter if sagitta else octets_of.pus_sequence_count
        self._with_count = octets_of.with_sagitta_counter if sagitta else octets_of.with_pus_sequence_count

    def message(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        found = self._count_of(message) if to_obc else None
        if found is not None:
            if self._count is None:
                self._count = found
            if self.strikes():
                message = self._with_count(message, self._count)
        forward(message)


class NotANumberSettings(FaultSettings):
    kind: Literal["telemetry.not_a_number"]
    component: Annotated[
        Literal["x", "y", "z", "w", "all"], Field(description="of the quaternion that is told")
    ] = "all"


class NotANumber(AtAttitude[NotANumberSettings], AtMessages[NotANumberSettings]):
    """In the messages, as no codec of the unit makes them; CANopen's objects take any float."""

    def __init__(self, settings: NotANumberSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._axes = "xyzw" if settings.component == "all" else settings.component
        self._dialect = reach.profile.wire.dialect

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        if self._dialect != "canopen" or not self.strikes():
            return report
        x, y, z, w = (
            math.nan if axis in self._axes else part
            for axis, part in zip("xyzw", report.q_icrs_to_sensor, strict=True)
        )
        return dataclasses.replace(report, q_icrs_to_sensor=(x, y, z, w))

    def message(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        if to_obc and self._dialect != "canopen":
            sagitta = self._dialect == "sagitta"
            change = octets_of.with_sagitta_nan if sagitta else octets_of.with_pus_nan
            changed = change(message, self._axes)
            if changed is not message and self.strikes():
                message = changed
        forward(message)


class Turning(AtAttitude[SettingsT]):
    """Tells another quaternion of each frame that is struck."""

    def turned(self, quaternion: Quaternion) -> Quaternion:
        """What is told in place of the frame's q_icrs_to_sensor (x, y, z, w)."""
        raise NotImplementedError

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        if not self.strikes():
            return report
        return dataclasses.replace(report, q_icrs_to_sensor=self.turned(report.q_icrs_to_sensor))


class OppositeSignSettings(FaultSettings):
    kind: Literal["telemetry.opposite_sign"]


class OppositeSign(Turning[OppositeSignSettings]):
    def turned(self, quaternion: Quaternion) -> Quaternion:
        x, y, z, w = quaternion
        return -x, -y, -z, -w


class WrongAttitudeSettings(FaultSettings):
    kind: Literal["telemetry.wrong_attitude"]
    deg: Annotated[float, Field(ge=-180, le=180, description="of the turn")] = 1.0
    axis: Annotated[Axis, Field(description="of the sensor, about which it is turned")] = "x"


class WrongAttitude(Turning[WrongAttitudeSettings]):
    """The attitude of a sensor that is turned by ``deg`` about one of its axes (right-handed)."""

    def turned(self, quaternion: Quaternion) -> Quaternion:
        half_rad = math.radians(self.settings.deg) / 2.0
        sine, a = math.sin(half_rad), math.cos(half_rad)
        u, v, t = (sine if axis == self.settings.axis else 0.0 for axis in "xyz")
        x, y, z, w = quaternion
        turned = (
            a * x + w * u - (v * z - t * y),
            a * y + w * v - (t * x - u * z),
            a * z + w * t - (u * y - v * x),
            a * w - u * x - v * y - t * z,
        )
        length = math.copysign(math.sqrt(sum(part * part for part in turned)), turned[3])
        qx, qy, qz, qw = (max(-1.0, min(1.0, part / length)) for part in turned)
        return qx, qy, qz, qw


_NEXT = "The next frame is told as it is; the unit itself was never disturbed."

KINDS: Final = (
    FaultKind(
        FrozenAttitudeSettings,
        FrozenAttitude,
        what="What the first processed frame of the fault gave is told of every frame behind it; frame "
        "number and time go on.",
        obc_sees="Attitude, rate, covariance and star counts that are the same to the last bit, valid, with "
        "new frame numbers and times. A real attitude has noise: two equal ones in a row are none.",
        afterwards=_NEXT,
    ),
    FaultKind(
        FrozenCounterSettings,
        FrozenCounter,
        what="The frame number of the attitude stands, its content goes on. Cyclic frames that are sent with "
        "each n-th frame follow the number that stands.",
        obc_sees="The same frame_index (on CAN: counter of the cyclic frames) with new times and attitudes.",
        afterwards=_NEXT,
        except_dialects=("sagitta", "nos3", "canopen"),
    ),
    FaultKind(
        StaleTimeSettings,
        StaleTime,
        what="The time of measurement stands where it was at the begin, or lags by lag_s; the content goes "
        "on. With sagitta it is the time in front of a solution.",
        obc_sees="New attitudes and frame numbers with an old time. In PUS the packet's own time goes on, "
        "and less the time of measurement it is no longer latency_us.",
        afterwards=_NEXT,
        except_dialects=("nos3",),
    ),
    FaultKind(
        JumpingTimeSettings,
        JumpingTime,
        what="The time of measurement of each frame that is struck is off by a random number up to most_s, "
        "either way. With sagitta it is the time in front of a solution.",
        obc_sees="Times that do not follow each other by the frame period and run backwards.",
        afterwards=_NEXT,
        except_dialects=("nos3",),
    ),
    FaultKind(
        StuckSequenceCountSettings,
        StuckSequenceCount,
        what="Each telemetry message has the sequence count (sagitta: the counter) of the first one of the "
        "fault; check sums are right.",
        obc_sees="The same sequence count again and again, with new content; in PUS the message type "
        "counters go on.",
        afterwards="The count is where it would be without the fault: a gap of as many as came.",
        dialects=("pus", "sagitta"),
    ),
    FaultKind(
        NotANumberSettings,
        NotANumber,
        what="Components of the quaternion are NaN (not a number), the check sum is right. Cyclic frames of "
        "PUS, whose numbers have a fixed point, cannot say it and stay good; nor can nos3.",
        obc_sees="A report that says valid and whose quaternion has NaN; whoever only compares lets it pass, "
        "as every comparison with NaN is false.",
        afterwards=_NEXT,
        dialects=("pus", "sagitta", "canopen"),
    ),
    FaultKind(
        OppositeSignSettings,
        OppositeSign,
        what="The quaternion has the other sign: the same attitude. Not for sagitta, whose scalar part is "
        "never negative.",
        obc_sees="A jump of all four components to their negatives; whoever differences or averages "
        "them sees a turn that was none.",
        afterwards=_NEXT,
        except_dialects=("sagitta",),
    ),
    FaultKind(
        WrongAttitudeSettings,
        WrongAttitude,
        what="The attitude is turned by deg about an axis of the sensor, and valid.",
        obc_sees="A step of the attitude by deg that no rate explains; rate, covariance and residuals are as "
        "good as ever.",
        afterwards="A step back with the next frame.",
    ),
)
