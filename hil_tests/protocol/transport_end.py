"""One end of ISO-TP by hand: frames as text without their identifiers, times in nanoseconds from 0."""

from __future__ import annotations

from dataclasses import replace

from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.can.transport import (
    IsoTpConnection,
    IsoTpEvent,
    IsoTpSettings,
    ReceptionFailed,
    TransmissionFailed,
)
from st_emulator.protocol.pus.enumerations import TransferFailure as Why

UNIT = IsoTpSettings(transmit_identifier=0x58A, receive_identifier=0x60A)
FD = replace(UNIT, fd=True, frame_bytes=64)
GO_ON = "30 00 00 CC CC CC CC CC"

# Mode 09, PID 02 of an OBD-II scan tool (SAE J1979): the vehicle identification number in 20 bytes.
VIN = bytes.fromhex("490201") + b"1M8GDM9AXKP042788"
VIN_FRAMES = ["10 14 49 02 01 31 4D 38", "21 47 44 4D 39 41 58 4B", "22 50 30 34 32 37 38 38"]


def incoming(text: str, settings: IsoTpSettings = UNIT, **flags: bool) -> CanFrame:
    flags = {"fd": settings.fd} | flags
    return CanFrame(settings.receive_identifier, bytes.fromhex(text), extended=settings.extended, **flags)


class End:
    """A connection, its frames as text."""

    def __init__(self, settings: IsoTpSettings = UNIT) -> None:
        self.connection = IsoTpConnection(settings)
        self.settings = settings

    def hears(self, text: str, now_ns: int = 0, **flags: bool) -> list[IsoTpEvent]:
        return self.connection.receive(incoming(text, self.settings, **flags), now_ns)

    def hands_over(self, now_ns: int = 0) -> str | None:
        frame = self.connection.next_frame(now_ns)
        if frame is None:
            return None
        self.frame = frame
        return frame.data.hex(" ").upper()

    def says(self, now_ns: int = 0) -> str | None:
        """Hands a frame over, and it leaves at once."""
        text = self.hands_over(now_ns)
        if text is not None:
            self.events = self.leaves(now_ns)
        return text

    def leaves(self, now_ns: int) -> list[IsoTpEvent]:
        return self.connection.confirmed(self.frame, now_ns)

    def poll(self, now_ns: int) -> list[IsoTpEvent]:
        return self.connection.poll(now_ns)

    @property
    def deadline_ns(self) -> int | None:
        return self.connection.next_deadline_ns()


def sending(data: bytes = VIN, settings: IsoTpSettings = UNIT) -> End:
    end = End(settings)
    end.connection.send(data, 0)
    return end


def receiving(settings: IsoTpSettings = UNIT) -> End:
    """In the middle of the VIN: first frame and flow control are over at 0."""
    end = End(settings)
    assert end.hears(VIN_FRAMES[0]) == []
    assert end.says() is not None
    return end


def failed(reason: Why, time_ns: int, length: int = len(VIN)) -> list[IsoTpEvent]:
    return [TransmissionFailed(reason, length, time_ns)]


def lost(reason: Why, time_ns: int, length: int = len(VIN)) -> list[IsoTpEvent]:
    return [ReceptionFailed(reason, length, time_ns)]
