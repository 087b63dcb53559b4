"""The contract of a dialect: one language in front of a device, on one wire.

A dialect gets the octets that its wire brings, gives the device commands and makes octets of its reports. It
holds whatever the language has beyond the device: addresses, counters, subscriptions, transfers. A new one
touches nothing of the device: it is a folder here, its messages in ``protocol``, and one
:class:`DialectDefinition`; or a package of a user's own project (``docs/adding_a_dialect.md``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar

from ..clock import VirtualClock
from ..device.speaker import Speaker
from ..device.star_tracker import StarTracker
from ..units.profile import UnitProfile
from ..units.validation import Section
from ..wire.can.bus import Disturbance, always
from ..wire.can.wiring import CanWiring
from ..wire.seam import PLAIN, MessageSeam

SettingsT = TypeVar("SettingsT", bound=Section)


class Dialect(Speaker, Protocol):
    """One language on one wire, talking for one device.

    It is made before power comes on, once for a whole run: resets and power cycles come as reports. All its
    delays are events of virtual time, by ``device.later`` (void after a reset or when power goes) or by the
    wire's clock; two of the same time run in the order in which they were scheduled. It tells the device by
    ``check`` and ``execute``, at one instant, and asks it; it sets nothing of it. What the device needs of it
    is :class:`~st_emulator.device.speaker.Speaker`: ``on`` a report, ``take_work``, ``drain_ns``.
    """

    def arrive(self, data: bytes) -> None:
        """The link brought ``data`` at the present time: octets of a serial line or records of CAN frames
        (:mod:`st_emulator.protocol.can.frames`), cut and joined anyhow. Nothing in them raises; what comes
        while the device does not listen is lost."""

    def where(self) -> str:
        """Where an OBC finds it, for people: rate and address, such as "115200 baud, APID 291"."""

    @property
    def messages_received(self) -> int:
        """Telecommands so far, good or bad."""

    @property
    def messages_sent(self) -> int:
        """Telemetry messages so far."""


@dataclass(frozen=True)
class SerialWire:
    """What a dialect on a serial line is made with.

    ``transmit`` takes octets when their last bit has left; ``pace_reception`` is False behind a real port,
    whose octets have already taken their time. ``messages`` is the seam where faults of whole messages enter.
    :class:`st_emulator.wire.serial_line.SerialLine` takes all of them.
    """

    clock: VirtualClock
    baud: int
    transmit: Callable[[bytes], object]
    pace_reception: bool = True
    messages: MessageSeam = PLAIN


@dataclass(frozen=True)
class CanWire:
    """What a dialect on a CAN bus is made with.

    ``transmit`` takes the record of a frame when its last bit has left and says whether the link took it;
    ``disturbance`` is the seam where faults of the bus enter, ``messages`` that of whole messages of many
    frames; ``recovers`` is asked before a controller that is bus-off comes back.
    """

    clock: VirtualClock
    wiring: CanWiring
    transmit: Callable[[bytes], bool]
    disturbance: Disturbance | None = None
    messages: MessageSeam = PLAIN
    recovers: Callable[[], bool] = always


class ScenarioSender(Protocol):
    """The OBC that a scenario's telecommands stand for, on the unit's own wire.

    It is given telecommands, and what the unit sends; what it has to say itself it leaves in its outbox,
    which the bench empties onto the wire before time goes on.
    """

    def send(self, message: bytes, now_ns: int) -> None:
        """A telecommand, as :attr:`DialectDefinition.encode` made it, is due."""

    def send_raw(self, octets: bytes, now_ns: int) -> None:
        """A telecommand's ``raw_hex`` is due."""

    def take(self, data: bytes, now_ns: int) -> None:
        """The unit has sent this."""

    def poll(self, now_ns: int) -> list[bytes]:
        """What goes onto the wire now, in order: octets of a line, or the record of a CAN frame each."""

    def next_ns(self) -> int | None:
        """When it has to be polled next though nothing happens; None when never."""


class DemoSession(Protocol):
    """A unit that speaks the dialect, in virtual time, for a scripted exchange that people look at
    (``st-emulator demo --dialect NAME``).
    """

    @property
    def profile(self) -> UnitProfile: ...

    @property
    def now_ns(self) -> int:
        """Virtual time since power-on."""

    def put(self, data: bytes) -> None:
        """Put octets on the line, or the record of a CAN frame on the bus, now."""

    def run(self, ms: float) -> list[tuple[int, bytes]]:
        """Let time go on; returns what the unit has sent meanwhile: (virtual time, octets or record)."""

    def true_quaternion(self, t_ns: int) -> tuple[float, float, float, float]:
        """q_icrs_to_sensor (x, y, z, w) of the truth at a virtual time."""

    def say(self, text: str) -> None:
        """A line for people: what is done or was found."""

    def check(
        self, name: str, value: float, relation: Literal["<=", ">=", "=="], target: float, unit: str
    ) -> None:
        """Something that must hold: ``value relation target``, the relation one of ==, <=, >=."""


@dataclass(frozen=True)
class DialectDefinition(Generic[SettingsT]):
    """One dialect: its name, its settings and how it is made.

    Args:
        name: as in ``[wire] dialect`` of a unit file and ``--dialect`` (a user's own is ``module:NAME``
            there), and of its table ``[dialects.NAME]``.
        title: one line for people.
        settings: what may stand in the unit file's table ``[dialects.NAME]``.
        on_serial, on_can: make it on a wire; None where the language has no such wire.
        encode: a scenario's telecommand by name and fields (of any type that TOML has), ``count``
            telecommands after the first, as the scenario's sender takes it; raises LocalProtocolError naming
            what is wrong and what is allowed.
        sender: the scenario's OBC on a wire: ``on_can`` says on which.
        exchange: the scripted exchange of the demo; None: it is another command's.
        document: the interface document, Markdown, from its message definitions; None: it is made elsewhere.
    """

    name: str
    title: str
    settings: type[SettingsT]
    on_serial: Callable[[StarTracker, SerialWire, SettingsT], Dialect] | None
    on_can: Callable[[StarTracker, CanWire, SettingsT], Dialect] | None
    encode: Callable[[UnitProfile, SettingsT, str, Mapping[str, Any], int], bytes]
    sender: Callable[[UnitProfile, SettingsT, CanWiring | None], ScenarioSender]
    exchange: Callable[[DemoSession], None] | None
    document: Callable[[], str] | None
