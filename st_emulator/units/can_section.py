"""The section ``[can]`` of a unit file: identifiers, periods and transport of the unit on a CAN bus."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from ..errors import ConfigurationError
from ..protocol.can.cyclic import BASE_STEP, NODES, CanIdentifiers, default_bases, highest_base
from .validation import Section

MAX_NODE = NODES[-1]
NO_PADDING = -1


def _separation_time(value: int) -> int:
    """What STmin of ISO 15765-2 can say."""
    if value % 1000 == 0 or (value < 1000 and value % 100 == 0):
        return value
    raise ValueError(
        f"found {value}; allowed are 100 to 900 in steps of 100 and 0 to 127000 in steps of 1000"
    )


Base = Annotated[int, Field(ge=0, le=highest_base(extended=True))] | None
Period = Annotated[int, Field(ge=0, le=1000)]


class CanBases(Section):
    """Bases of the identifiers, multiples of 128, all different; the node number is added to all but those of
    sync and time_at_sync. Default: those of the interface document.
    """

    sync: Base = None
    time_at_sync: Base = None
    attitude_1: Base = None
    attitude_2: Base = None
    rates: Base = None
    sync_time: Base = None
    status: Base = None
    mid_exposure_time: Base = None
    telemetry: Base = None
    telecommand: Base = None
    heartbeat: Base = None


class CanSection(Section):
    """The unit on a CAN bus. ``padding``: byte behind the end of the data in ISO-TP frames, -1 for none.
    ``heartbeat_ms`` 0: never. ``..._frames``: sent with each n-th frame of the sensor, 0: never.
    """

    node: Annotated[int, Field(ge=NODES[0], le=MAX_NODE)] = 10
    identifier_bits: Literal[11, 29] = 11
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000
    data_bitrate: Annotated[int, Field(ge=10_000, le=8_000_000)] = 4_000_000
    block_size: Annotated[int, Field(ge=0, le=255)] = 0
    separation_time_us: Annotated[int, Field(ge=0, le=127_000), AfterValidator(_separation_time)] = 0
    padding: Annotated[int, Field(ge=NO_PADDING, le=255)] = 0xCC
    timeout_ms: Annotated[int, Field(ge=10, le=60_000)] = 1000
    bus_off_restart_ms: Annotated[int, Field(ge=0, le=60_000)] = 100
    heartbeat_ms: Annotated[int, Field(ge=0, le=60_000)] = 1000
    attitude_frames: Period = 1
    rates_frames: Period = 1
    status_frames: Period = 1
    time_frames: Period = 1
    identifiers: CanBases = CanBases()

    @property
    def extended(self) -> bool:
        """Whether the identifiers have 29 bits."""
        return self.identifier_bits == 29

    @property
    def padding_byte(self) -> int | None:
        """The byte that fills ISO-TP frames, None for none."""
        return None if self.padding == NO_PADDING else self.padding

    @property
    def bases(self) -> dict[str, int]:
        """Base of each identifier: the file's, else the default one."""
        own = {name: base for name, base in self.identifiers.model_dump().items() if base is not None}
        return default_bases(self.extended) | own

    @model_validator(mode="after")
    def _bases_fit(self) -> CanSection:
        highest = highest_base(self.extended)
        taken: dict[int, str] = {}
        for name, base in self.bases.items():
            if base % BASE_STEP or base > highest:
                raise ValueError(
                    f"identifiers.{name} = 0x{base:X}: allowed are multiples of 0x{BASE_STEP:X} from 0 to "
                    f"0x{highest:X} (identifier_bits = {self.identifier_bits})"
                )
            if base in taken:
                raise ValueError(
                    f"identifiers.{taken[base]} and identifiers.{name} are both 0x{base:X}: allowed are "
                    f"different ones"
                )
            taken[base] = name
        if self.data_bitrate < self.bitrate:
            raise ValueError(
                f"data_bitrate = {self.data_bitrate} is less than bitrate = {self.bitrate}: allowed is the "
                "same or more"
            )
        if self.heartbeat_ms and self.heartbeat_ms < 10:
            raise ValueError(f"heartbeat_ms = {self.heartbeat_ms}: allowed are 0 (never) and 10 to 60000")
        return self

    def identifier_table(self, node: int | None = None) -> CanIdentifiers:
        """The identifiers of the unit as the file's node or as ``node``.

        Raises:
            ConfigurationError: ``node`` is not in 1..127.
        """
        number = self.node if node is None else node
        if number not in NODES:
            raise ConfigurationError(f"CAN node {number}: allowed is a whole number from 1 to {MAX_NODE}")
        return CanIdentifiers(number, self.extended, self.bases)

    def cycle_times_ms(self, frame_period_ms: int) -> dict[str, int]:
        """Time between two frames of each cyclic kind, 0 where it is never sent."""
        frames = {
            "attitude_1": self.attitude_frames,
            "attitude_2": self.attitude_frames,
            "rates": self.rates_frames,
            "status": self.status_frames,
            "mid_exposure_time": self.time_frames,
        }
        return {"heartbeat": self.heartbeat_ms} | {
            name: count * frame_period_ms for name, count in frames.items()
        }
