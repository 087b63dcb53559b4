"""A unit and an OBC in one process, on one clock and with one date.

Nothing waits in real time: while the OBC waits, the unit's virtual clock goes on from event to event, so that
the OBC sees each octet at the time at which it has left the unit. The OBC's civil time is the scenario's
``start_utc`` and what has passed since: a time that it sets is that of the sky.
"""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from ..links import memory_link_pair
from ..obc import CanSettings, CanTransport, Obc, SlipTransport, SteppedReader
from ..units.profile import UnitProfile
from ..wire.can.wiring import CanWiring
from .emulator import Emulator
from .scenario import Scenario

CAPACITY_BYTES = 1 << 22


def can_transport_of(profile: UnitProfile, wiring: CanWiring) -> CanTransport:
    """How an OBC talks to a unit that is wired like this to a CAN bus."""
    settings = wiring.port_settings(profile.can)
    return CanTransport(
        settings.identifiers,
        CanSettings(
            fd=settings.fd,
            padding=settings.padding,
            timeout_ns=settings.timeout_ns,
            bitrate=settings.bus.bitrate,
            data_bitrate=settings.bus.data_bitrate,
        ),
    )


class JoinedBench:
    """A unit that speaks PUS and its OBC.

    Args:
        profile, scenario: the unit and its world.
        can: both are on a CAN bus, wired like this; None: on the serial line.
        arguments: further ones of :class:`~st_emulator.bench.emulator.Emulator`.
    """

    def __init__(
        self,
        profile: UnitProfile,
        scenario: Scenario | None = None,
        *,
        can: CanWiring | None = None,
        **arguments: Any,
    ) -> None:
        self._unit_end, obc_end = memory_link_pair(CAPACITY_BYTES)
        self.emulator = Emulator(profile, scenario, can=can, transmit=self._transmitted, **arguments)
        reader = SteppedReader(
            self._step,
            next_event_ns=self.emulator.next_event_ns,
            epoch=self.emulator.scenario.start_utc,
            now_ns=self.emulator.now_ns,
        )
        self.obc = Obc(
            obc_end,
            apid=profile.apid,
            source_id=profile.wire.source_id,
            reader=reader,
            transport=SlipTransport(self.emulator.baud) if can is None else can_transport_of(profile, can),
        )

    def _transmitted(self, data: bytes, t_ns: int) -> int:
        return self._unit_end.write(data)

    def _step(self, until_ns: int) -> None:
        # What the OBC has written since the last step it wrote at the present time.
        self.emulator.receive(self._unit_end.read())
        self.emulator.advance(until_ns)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.obc.close()
        self.emulator.close()
