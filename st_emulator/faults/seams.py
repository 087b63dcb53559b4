"""The seams of one run, and the faults that stand at them now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from ..device.imaging import FrameSource
from ..device.reports import AttitudeReady, Report
from ..device.speaker import Speaker
from ..firmware_model.image.frame import Frame
from ..firmware_model.processor import ProcessorProfile
from ..firmware_model.work import Work
from ..protocol.can.frames import CanFrame, RecordDecoder, encode_record
from ..wire.can.controller import BusError
from ..wire.seam import Forward
from .fault import (
    AtAttitude,
    AtBus,
    AtFrames,
    AtMessages,
    AtOctets,
    AtProcessor,
    AtReports,
    AtSensor,
    AtSynchronisation,
    AtWriting,
    Exposure,
    Fault,
)

FaultT = TypeVar("FaultT")


class Seams:
    """Passes everything through the faults that are active, in the order in which they began."""

    def __init__(self) -> None:
        self._active: list[Fault[Any]] = []

    def add(self, fault: Fault[Any]) -> None:
        """It stands at its seams from now on."""
        self._active.append(fault)

    def remove(self, fault: Fault[Any]) -> None:
        self._active.remove(fault)

    def _at(self, seam: type[FaultT]) -> list[FaultT]:
        return [fault for fault in self._active if isinstance(fault, seam)]

    # -- the wire (see wire.seam)

    def to_obc(self, message: bytes, forward: Forward) -> None:
        self._through(self._at(AtMessages), message, True, forward)

    def to_unit(self, message: bytes, forward: Forward) -> None:
        self._through(self._at(AtMessages), message, False, forward)

    # -- the link

    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        """What becomes of octets of a serial line."""
        for fault in self._at(AtOctets):
            octets = fault.octets(octets, to_obc)
        return octets

    def records(self, records: bytes, to_obc: bool, forward: Forward) -> None:
        """Pass CAN frames on; what is no record goes on as it is."""
        faults = self._at(AtFrames)
        if not faults:
            forward(records)
            return
        for frame in RecordDecoder().receive(records):
            self._frame_through(faults, frame, to_obc, lambda one: forward(encode_record(one)))

    def disturbance(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        for fault in self._at(AtBus):
            if (error := fault.attempt(frame, own, now_ns)) is not None:
                return error
        return None

    def recovers(self) -> bool:
        """Whether a controller that is bus-off may come back now."""
        return not any(fault.withholds_recovery for fault in self._at(AtBus))

    # -- the device (see device.seams)

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        for fault in self._at(AtAttitude):
            report = fault.attitude(report)
        return report

    def processor(self, processor: ProcessorProfile) -> ProcessorProfile:
        for fault in self._at(AtProcessor):
            processor = fault.processor(processor)
        return processor

    def written(self, memory: str, octets: bytes) -> bytes:
        for fault in self._at(AtWriting):
            octets = fault.written(memory, octets)
        return octets

    def synchronises(self) -> bool:
        return all(fault.synchronises() for fault in self._at(AtSynchronisation))

    def reported(self, report: Report) -> None:
        for fault in self._at(AtReports):
            fault.report(report)

    def sensor(self, frame: Frame | None, exposure: Exposure) -> Frame | None:
        """What the sensor delivers of an exposure."""
        for fault in self._at(AtSensor):
            if frame is None:
                return None
            frame = fault.expose(frame, exposure)
        return frame

    # -- one fault behind the other; what one has kept back does not meet those that ended meanwhile

    def _through(self, faults: list[AtMessages[Any]], message: bytes, to_obc: bool, forward: Forward) -> None:
        faults = [fault for fault in faults if fault in self._active]
        if not faults:
            forward(message)
            return
        rest = faults[1:]
        faults[0].message(message, to_obc, lambda changed: self._through(rest, changed, to_obc, forward))

    def _frame_through(
        self,
        faults: list[AtFrames[Any]],
        frame: CanFrame,
        to_obc: bool,
        forward: Callable[[CanFrame], None],
    ) -> None:
        faults = [fault for fault in faults if fault in self._active]
        if not faults:
            forward(frame)
            return
        rest = faults[1:]
        faults[0].frame(frame, to_obc, lambda changed: self._frame_through(rest, changed, to_obc, forward))


@dataclass(frozen=True)
class SeamedSource:
    """A source of frames behind the sensor's seam."""

    source: FrameSource
    seams: Seams

    def frame(self, frame_index: int, exposure_start_ns: int, exposure_ns: int) -> Frame | None:
        frame = self.source.frame(frame_index, exposure_start_ns, exposure_ns)
        return self.seams.sensor(frame, Exposure(frame_index, exposure_start_ns, exposure_ns))


@dataclass(frozen=True)
class SeamedSpeaker:
    """A dialect whose reports are looked at."""

    speaker: Speaker
    seams: Seams

    def on(self, report: Report) -> None:
        self.speaker.on(report)
        self.seams.reported(report)

    def take_work(self) -> Work:
        return self.speaker.take_work()

    def drain_ns(self) -> int:
        return self.speaker.drain_ns()
