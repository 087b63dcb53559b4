"""Faults of the CAN bus: attempts that are destroyed, frames that are lost, and nodes that misbehave.

What destroys attempts needs the modelled bus: on a real one (a link of hardware) nobody here has a hand in
it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from ..clock import NS_PER_MS
from ..protocol.can.bits import frame_duration_ns
from ..protocol.can.cyclic import TELECOMMAND
from ..protocol.can.frames import MAX_EXTENDED_IDENTIFIER, MAX_STANDARD_IDENTIFIER, CanFrame, encode_record
from ..units.validation import Switch
from ..wire.can.bus import CanBusSettings
from ..wire.can.controller import CLASS_BUS_OFF, BusError
from .fault import AtBus, AtFrames, DirectedSettings, FaultKind, FaultSettings, Reach, SettingsT
from .line_signal import Always
from .timing import Holding, Repeating, goes

FLOW_CONTROL = 3  # the high half of the first octet (ISO 15765-2, 9.6.1)
ERROR_MESSAGE_OCTETS = 8


def modelled_bus(reach: Reach) -> CanBusSettings:
    """The rates of the modelled bus.

    Raises:
        ValueError: the unit is on a real one.
    """
    assert reach.can is not None
    if reach.can.hardware:
        raise ValueError("the bus is a real one, and only a modelled bus has such a fault")
    return reach.can.port_settings(reach.profile.can).bus


class OnModelledBus(AtBus[SettingsT]):
    def __init__(self, settings: SettingsT, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self.bus = modelled_bus(reach)


class ErrorFramesSettings(DirectedSettings):
    kind: Literal["bus.error_frames"]
    error: Annotated[
        Literal["bit", "stuff", "form", "crc", "ack"],
        Field(description="what the error is; an attempt takes the longer, the later it is found"),
    ] = "bit"


class ErrorFrames(OnModelledBus[ErrorFramesSettings]):
    """Attempts end in an error frame."""

    def attempt(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        if not goes(self.settings.direction, own) or not self.strikes():
            return None
        return BusError[self.settings.error.upper()]


class BusOffSettings(FaultSettings):
    kind: Literal["bus.bus_off"]
    probability: Always = 1.0


class BusOff(OnModelledBus[BusOffSettings]):
    """The unit's controller is bus-off and stays so."""

    withholds_recovery = True

    def begin(self) -> None:
        told = CanFrame(CLASS_BUS_OFF, bytes(ERROR_MESSAGE_OCTETS), error=True)
        self.reach.to_unit(encode_record(told))

    def attempt(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        return BusError.BIT if own else None  # a unit that starts meanwhile comes to it by itself


class NoAcknowledgeSettings(FaultSettings):
    kind: Literal["bus.no_acknowledge"]


class NoAcknowledge(OnModelledBus[NoAcknowledgeSettings]):
    def attempt(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        return BusError.ACK if own and self.strikes() else None


class StuckDominantSettings(FaultSettings):
    kind: Literal["bus.stuck_dominant"]
    probability: Always = 1.0


class StuckDominant(OnModelledBus[StuckDominantSettings]):
    """No frame of anybody gets through, and bus-off has no end: there are no recessive bits to count."""

    withholds_recovery = True

    def attempt(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        return BusError.BIT


class BabblingNodeSettings(FaultSettings):
    kind: Literal["bus.babbling_node"]
    frames_per_s: Annotated[float, Field(ge=0.001, le=20_000, description="at most what the bus carries")] = (
        2000.0
    )
    identifier: Annotated[
        int, Field(ge=0, le=MAX_EXTENDED_IDENTIFIER, description="of its frames; the lower one goes first")
    ] = 1
    extended: Annotated[Switch, Field(description="29 bits instead of 11")] = False
    octets: Annotated[int, Field(ge=0, le=8, description="of data in a frame, random ones")] = 8

    @model_validator(mode="after")
    def _fits(self) -> BabblingNodeSettings:
        if not self.extended and self.identifier > MAX_STANDARD_IDENTIFIER:
            raise ValueError(
                f"identifier = {self.identifier} has more than 11 bits; allowed are 0 to "
                f"{MAX_STANDARD_IDENTIFIER}, or extended = true"
            )
        return self


class BabblingNode(Repeating[BabblingNodeSettings], OnModelledBus[BabblingNodeSettings]):
    """A node with one frame at a time, which takes part in the arbitration like any other."""

    def __init__(self, settings: BabblingNodeSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._waiting: CanFrame | None = None  # has not been on the wire

    def rate_hz(self) -> float:
        return self.settings.frames_per_s

    def once(self) -> None:
        if self._waiting is None:
            settings = self.settings
            data = self.random.randbytes(settings.octets)
            self._waiting = CanFrame(settings.identifier, data, settings.extended)
            self.reach.to_unit(encode_record(self._waiting))

    def attempt(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        if not own and frame == self._waiting:
            self._waiting = None
            duration_ns = frame_duration_ns(frame, self.bus.bitrate, self.bus.data_bitrate)
            self.reach.clock.at(now_ns + duration_ns, partial(self._hear, frame))
        return None

    def _hear(self, frame: CanFrame) -> None:
        self.reach.to_obc(encode_record(frame))


class FramesLostSettings(DirectedSettings):
    kind: Literal["bus.frames_lost"]


class FramesLost(AtFrames[FramesLostSettings]):
    def frame(self, frame: CanFrame, to_obc: bool, forward: Callable[[CanFrame], None]) -> None:
        if not goes(self.settings.direction, to_obc) or not self.strikes():
            forward(frame)


class FramesDelayedSettings(DirectedSettings):
    kind: Literal["bus.frames_delayed"]
    delay_ms: Annotated[float, Field(ge=0, le=3_600_000, description="of each that is struck")] = 50.0


class FramesDelayed(AtFrames[FramesDelayedSettings], Holding[FramesDelayedSettings]):
    def frame(self, frame: CanFrame, to_obc: bool, forward: Callable[[CanFrame], None]) -> None:
        if goes(self.settings.direction, to_obc) and self.strikes():
            self.hold(partial(forward, frame), to_obc, round(self.settings.delay_ms * NS_PER_MS))
        else:
            forward(frame)


class NoFlowControlSettings(FaultSettings):
    kind: Literal["bus.no_flow_control"]


class NoFlowControl(AtFrames[NoFlowControlSettings]):
    """Flow control of the OBC does not reach the unit."""

    def __init__(self, settings: NoFlowControlSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        assert reach.can is not None
        self._identifiers = reach.can.port_settings(reach.profile.can).identifiers

    def frame(self, frame: CanFrame, to_obc: bool, forward: Callable[[CanFrame], None]) -> None:
        if to_obc or not self._is_flow_control(frame) or not self.strikes():
            forward(frame)

    def _is_flow_control(self, frame: CanFrame) -> bool:
        if self._identifiers.name_of(frame.identifier, frame.extended) != TELECOMMAND:
            return False
        return bool(frame.data) and frame.data[0] >> 4 == FLOW_CONTROL


KINDS: Final = (
    FaultKind(
        ErrorFramesSettings,
        ErrorFrames,
        what="An attempt to send a frame that is struck ends in an error frame: the unit's own (to_obc), "
        "those of other nodes (to_unit), or both. The sender tries again until it gets through.",
        obc_sees="Frames that come later than usual; with many errors the unit tells that it has become "
        "error passive (CAN_ERROR_PASSIVE_ENTERED), and when its counter of transmit errors is above 255 it "
        "is bus-off: nothing comes for the time of its restart and 1408 bits, then CAN_BUS_OFF_RECOVERED. "
        "Its counters tell how many error frames there were.",
        afterwards="Frames come in time; the error counters go down with each good frame.",
        wires=("can",),
    ),
    FaultKind(
        BusOffSettings,
        BusOff,
        what="The unit's controller is bus-off at once and does not come back while the fault lasts.",
        obc_sees="Nothing at all of the unit: no heartbeat, no attitude, no answer.",
        afterwards="Within 2816 bits, or its restart time where that has not passed, it is back and tells "
        "CAN_BUS_OFF_RECOVERED with how long it was off; packets that it could not send are counted in "
        "CAN_PACKETS_LOST.",
        wires=("can",),
    ),
    FaultKind(
        NoAcknowledgeSettings,
        NoAcknowledge,
        what="Nobody acknowledges the unit's frames that are struck, as on a bus without another node.",
        obc_sees="Nothing of the unit, though the bus is busy with its attempts; it becomes error passive "
        "(CAN_ERROR_PASSIVE_ENTERED) and, as ISO 11898-1 says, never bus-off by this.",
        afterwards="Its frames come at once, and CAN_PACKETS_LOST where packets (that event among them) "
        "have waited for longer than the transport's timeout.",
        wires=("can",),
    ),
    FaultKind(
        BabblingNodeSettings,
        BabblingNode,
        what="Another node sends frames of a low identifier, frames_per_s of them, one at a time: it wins "
        "the arbitration of all frames of higher ones.",
        obc_sees="The babbling node's frames; those of the unit later, and none where the bus is full; its "
        "counter arbitration_lost goes up.",
        afterwards="The bus is free at once; packets that waited for too long are counted in "
        "CAN_PACKETS_LOST, cyclic frames that a newer one took the place of in cyclic_overruns.",
        wires=("can",),
    ),
    FaultKind(
        FramesLostSettings,
        FramesLost,
        what="A CAN frame that is struck is acknowledged and yet does not reach its receiver, as with a full "
        "mailbox.",
        obc_sees="Counters of cyclic frames with gaps; transfers of packets that break off for want of a "
        "consecutive frame or of flow control.",
        afterwards="Each frame comes; packets lost meanwhile are not sent again.",
        wires=("can",),
    ),
    FaultKind(
        FramesDelayedSettings,
        FramesDelayed,
        what="A CAN frame that is struck reaches its receiver delay_ms later, as through a gateway; others "
        "overtake it.",
        obc_sees="Frames older than usual; where not all are struck, out of their order, so that transfers "
        "of packets break off.",
        afterwards="What is still held back comes at once, in its order; then all is in time.",
        wires=("can",),
    ),
    FaultKind(
        StuckDominantSettings,
        StuckDominant,
        what="The bus is held dominant: no frame of anybody gets through.",
        obc_sees="Nothing; its own controller goes bus-off as the unit's does.",
        afterwards="The unit is back within 2816 bits, or its restart time where that has not passed, and "
        "tells CAN_BUS_OFF_RECOVERED; frames of the OBC that its controller has kept come through then.",
        wires=("can",),
    ),
    FaultKind(
        NoFlowControlSettings,
        NoFlowControl,
        what="Flow control frames of the OBC (ISO-TP) do not reach the unit.",
        obc_sees="First frames of packets, one in each timeout of the transport (N_Bs), and no consecutive "
        "frames; cyclic frames and packets of a single frame come as ever.",
        afterwards="Packets come again; CAN_PACKETS_LOST tells how many did not, reason TIMEOUT_BS.",
        wires=("can",),
        dialects=("pus",),
    ),
)
