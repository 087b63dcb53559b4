"""The device's seams: where outside hands may change what passes. Each is an identity unless one does."""

from __future__ import annotations

from typing import Final, Protocol

from ..firmware_model.processor import ProcessorProfile
from .reports import AttitudeReady


class DeviceSeams(Protocol):
    """What passes through the device, in passing."""

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        """What is told of a frame; how the unit goes on does not follow it."""

    def processor(self, processor: ProcessorProfile) -> ProcessorProfile:
        """The processor that works on a frame that is exposed now."""

    def written(self, memory: str, octets: bytes) -> bytes:
        """What of ``octets`` stands in a memory after they were written: all, other ones, or the first of
        them, when power went meanwhile."""

    def synchronises(self) -> bool:
        """Whether a set time that waits comes into force at this frame's start."""


class _Plain:
    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        return report

    def processor(self, processor: ProcessorProfile) -> ProcessorProfile:
        return processor

    def written(self, memory: str, octets: bytes) -> bytes:
        return octets

    def synchronises(self) -> bool:
        return True


PLAIN: Final[DeviceSeams] = _Plain()
