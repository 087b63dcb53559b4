"""How a unit is wired to a CAN bus: what the link and the command line say, beside the unit's file."""

from __future__ import annotations

from dataclasses import dataclass

from ...clock import NS_PER_MS
from ...units.can_section import CanSection
from .bus import CanBusSettings
from .port import CanPortSettings


@dataclass(frozen=True)
class CanWiring:
    """``bitrate`` and ``node``: the unit file's when None. ``fd``: packets travel in CAN FD frames.
    ``hardware``: a real controller is behind the link, which gives frames their time on the wire itself.
    """

    bitrate: int | None = None
    fd: bool = False
    node: int | None = None
    hardware: bool = False

    def port_settings(self, unit: CanSection) -> CanPortSettings:
        """The settings of the port of a unit whose file has the section ``unit``."""
        bitrate = self.bitrate or unit.bitrate
        return CanPortSettings(
            identifiers=unit.identifier_table(self.node),
            bus=CanBusSettings(
                bitrate=bitrate,
                data_bitrate=max(unit.data_bitrate, bitrate),
                hardware=self.hardware,
                bus_off_restart_ms=unit.bus_off_restart_ms,
            ),
            fd=self.fd,
            padding=unit.padding_byte,
            block_size=unit.block_size,
            separation_time_us=unit.separation_time_us,
            timeout_ns=unit.timeout_ms * NS_PER_MS,
        )
