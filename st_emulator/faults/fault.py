"""What a fault is: its settings, its time, what it may reach, and the seams at which it can stand.

A fault is made for one run. It begins and ends by the virtual clock, and in between its seam asks it about
everything that passes. Its chances follow from its seed and from the order of what it was asked, so that the
same run has the same faults; where frames of the sensor are concerned, from its seed and the frame's number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from random import Random
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar, get_args

import numpy as np
from pydantic import Field, model_validator

from ..clock import NS_PER_S, VirtualClock
from ..device.reports import AttitudeReady, Report
from ..device.star_tracker import StarTracker
from ..firmware_model.image.frame import Frame
from ..firmware_model.processor import ProcessorProfile
from ..protocol.can.frames import CanFrame
from ..units.profile import UnitProfile
from ..units.validation import Section
from ..wire.can.controller import BusError
from ..wire.can.wiring import CanWiring
from ..wire.seam import Forward
from .store import SeamedStore
from .supply import Supply

Seconds = Annotated[float, Field(ge=0, le=10**9)]
Wire = Literal["serial", "can"]
Direction = Literal["to_obc", "to_unit", "both"]


class FaultSettings(Section):
    """What every fault has. Times are virtual, from power-on."""

    kind: str
    start_s: Annotated[Seconds | None, Field(description="none: at once")] = None
    end_s: Seconds | None = None
    duration_s: Annotated[Seconds | None, Field(description="instead of end_s; neither: for ever")] = None
    probability: Annotated[
        float, Field(gt=0, le=1, description="for each thing that passes the seam while the fault lasts")
    ] = 1.0
    seed: Annotated[
        int | None, Field(ge=0, le=2**63 - 1, description="none: from the run's seed and the fault's number")
    ] = None

    @model_validator(mode="after")
    def _one_end(self) -> FaultSettings:
        if self.end_s is not None and self.duration_s is not None:
            raise ValueError("give end_s or duration_s, not both")
        if self.end_s is not None and self.end_s < (self.start_s or 0.0):
            raise ValueError(f"end_s = {self.end_s:g} comes before start_s = {self.start_s or 0.0:g}")
        return self

    def window_ns(self, now_ns: int) -> tuple[int, int | None]:
        """(start, end or None) of a fault that is put in at ``now_ns``."""
        start_ns = now_ns if self.start_s is None else max(now_ns, round(self.start_s * NS_PER_S))
        if self.end_s is not None:
            return start_ns, max(start_ns, round(self.end_s * NS_PER_S))
        if self.duration_s is not None:
            return start_ns, start_ns + round(self.duration_s * NS_PER_S)
        return start_ns, None


class DirectedSettings(FaultSettings):
    """Of a fault of what goes to and fro."""

    direction: Annotated[Direction, Field(description="which way what it strikes goes")] = "to_obc"


@dataclass
class Reach:
    """What a fault may lay its hands on.

    ``to_obc`` and ``to_unit`` put octets of the line, or the record of a CAN frame, on the link beyond the
    seams: as somebody on the wire would. ``store``: the non-volatile memory. ``supply``: its power. ``can``:
    how the unit is on its bus.
    """

    clock: VirtualClock
    profile: UnitProfile
    device: StarTracker
    to_obc: Callable[[bytes], object]
    to_unit: Callable[[bytes], None]
    wire: Wire
    baud: int
    store: SeamedStore
    supply: Supply
    can: CanWiring | None = None


SettingsT = TypeVar("SettingsT", bound=FaultSettings)


class Fault(Generic[SettingsT]):
    """One fault of a run. Subclasses stand at seams by the classes below.

    ``instant``: it is over when it has begun (it did what it does).
    """

    instant: ClassVar[bool] = False

    def __init__(self, settings: SettingsT, reach: Reach, seed: int) -> None:
        self.settings = settings
        self.reach = reach
        self.seed = seed

    @cached_property
    def random(self) -> Random:
        """Its chance, in the order of what it was asked."""
        return Random(self.seed)

    def strikes(self) -> bool:
        """Whether it strikes what passes now."""
        return self.settings.probability >= 1.0 or self.random.random() < self.settings.probability

    def generator(self, number: int) -> np.random.Generator:
        """Chance for one numbered thing, whatever was asked before (a frame is made when it is needed)."""
        return np.random.default_rng([self.seed, number])

    def begin(self) -> None:
        """It starts now."""

    def end(self) -> None:
        """It is over; what it did not destroy is as it was."""


class AtOctets(Fault[SettingsT]):
    """On the link: octets of a serial line in groups of any size."""

    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        """What becomes of them."""
        raise NotImplementedError


class AtMessages(Fault[SettingsT]):
    """Whole messages, before framing or behind it."""

    def message(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        """Call ``forward`` with what goes on, now or later."""
        raise NotImplementedError


class AtFrames(Fault[SettingsT]):
    """On the link: CAN frames, one by one."""

    def frame(self, frame: CanFrame, to_obc: bool, forward: Callable[[CanFrame], None]) -> None:
        """Call ``forward`` with what goes on, now or later."""
        raise NotImplementedError


class AtBus(Fault[SettingsT]):
    """Each attempt to send a frame on the modelled CAN bus.

    ``withholds_recovery``: a controller that is bus-off stays so while the fault lasts.
    """

    withholds_recovery: ClassVar[bool] = False

    def attempt(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        """What destroys it, or None."""
        raise NotImplementedError


@dataclass(frozen=True)
class Exposure:
    """A frame's number and when it was exposed, virtual ns."""

    index: int
    start_ns: int
    duration_ns: int


class AtSensor(Fault[SettingsT]):
    """Frames between the sensor and the firmware."""

    def expose(self, frame: Frame, exposure: Exposure) -> Frame | None:
        """What the sensor delivers in place of ``frame``; None: nothing. Pixels are touched only when the
        frame that is returned is asked for them."""
        raise NotImplementedError


class AtAttitude(Fault[SettingsT]):
    """What the device tells of a frame."""

    def attitude(self, report: AttitudeReady) -> AttitudeReady:
        """What it tells in its place."""
        raise NotImplementedError


class AtReports(Fault[SettingsT]):
    """Looks on while the device tells."""

    def report(self, report: Report) -> None:
        """The dialect has been told this."""
        raise NotImplementedError


class AtProcessor(Fault[SettingsT]):
    """The processor that works on a frame."""

    def processor(self, processor: ProcessorProfile) -> ProcessorProfile:
        """What it is in place of ``processor``."""
        raise NotImplementedError


class AtWriting(Fault[SettingsT]):
    """Octets that are written into a memory: "ram", "program", "parameters"."""

    def written(self, memory: str, octets: bytes) -> bytes:
        """What stands there then; fewer when power goes meanwhile."""
        raise NotImplementedError


class AtSynchronisation(Fault[SettingsT]):
    """The instant at which a set time comes into force."""

    def synchronises(self) -> bool:
        raise NotImplementedError


@dataclass(frozen=True)
class FaultKind:
    """A line of the list of faults.

    ``seam``: where it enters. ``what``: what happens. ``obc_sees``: what an OBC must see on the wire.
    ``afterwards``: what comes when it is over. ``wires``: where there is such a thing.
    ``dialects``: in which languages; None: all but ``except_dialects``.
    """

    settings: type[FaultSettings]
    make: Callable[[Any, Reach, int], Fault[Any]]
    what: str
    obc_sees: str
    afterwards: str
    wires: tuple[Wire, ...] = ("serial", "can")
    dialects: tuple[str, ...] | None = None
    except_dialects: tuple[str, ...] = ()

    def spoken_in(self, dialect: str) -> bool:
        """Whether there is such a thing in a language."""
        return dialect not in self.except_dialects and (self.dialects is None or dialect in self.dialects)

    @property
    def name(self) -> str:
        """SEAM.NAME, as in a scenario's ``kind``."""
        (name,) = get_args(self.settings.model_fields["kind"].annotation)
        return str(name)

    @property
    def seam(self) -> str:
        return self.name.partition(".")[0]
