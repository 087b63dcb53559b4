"""Telemetry packets out: sequence counts, message type counters, time stamps, the queue in front of the
wire.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any

from ...device.star_tracker import StarTracker
from ...firmware_model.link_work import packet_work
from ...firmware_model.work import Work
from ...protocol.pus.registry import REGISTRY, encode_telemetry
from ...wire.port import UnitPort
from .time_code import cuc_at, time_status

# ASSUMED: half of a 64 KiB telemetry buffer; a quarter more is kept for verification and events, so that they
# find room when everything else is lost.
QUEUE_LIMIT_BYTES = 32768
RESERVED_BYTES = 16384
RESERVED_SERVICES = (1, 5)


class Transmitter:
    """Builds and queues the unit's telemetry. A packet that finds the queue full is lost, never half sent.

    ``packets`` and ``bytes`` count what was queued, ``lost_packets`` what was lost and not told yet;
    ``on_lost`` is told how many when there is room again. ``work`` is that of building packets, lost ones
    too, since the last :meth:`take_work`.
    """

    def __init__(self, device: StarTracker, port: UnitPort, apid: int, destination_id: int) -> None:
        self._device = device
        self._port = port
        self._apid = apid
        self._destination_id = destination_id
        self._sequence_count = 0
        self._message_counts: defaultdict[tuple[int, int], int] = defaultdict(int)
        self.packets = 0
        self.bytes = 0
        self.lost_packets = 0
        self.work = Work()
        self.on_lost: Callable[[int], None] = lambda packets: None

    def reset(self) -> None:
        """Sequence and message counts start anew; what waits in the port is lost."""
        self._port.restart()
        self._sequence_count = 0
        self._message_counts.clear()
        self.lost_packets = 0
        self.work = Work()

    def clear_counters(self) -> None:
        """Count from 0."""
        self.packets = self.bytes = 0

    @property
    def has_room(self) -> bool:
        """Whether half of the queue is free: time to tell what was lost, without losing that as well."""
        return self._port.queued_bytes <= QUEUE_LIMIT_BYTES // 2

    def take_work(self) -> Work:
        """The work since the last call."""
        work, self.work = self.work, Work()
        return work

    def send(self, name: str, fields: dict[str, Any], destination_id: int | None = None) -> bool:
        """Queue the telemetry message ``name``; False when the queue was full and the packet is lost, and in
        BOOT and OFF, where nothing leaves.

        ``destination_id``: the source of the telecommand that it answers; the unit's own default for all
        else.
        """
        if self._device.silent:
            return False
        definition = REGISTRY.by_name(name)
        kind = (definition.service, definition.subservice)
        packet = encode_telemetry(
            name,
            fields,
            apid=self._apid,
            sequence_count=self._sequence_count,
            message_count=self._message_counts[kind],
            destination_id=self._destination_id if destination_id is None else destination_id,
            time=cuc_at(self._device, self._device.clock.now_ns),
            time_status=int(time_status(self._device)),
        )
        data = fields.get("data")  # a copy of an image or of memory
        copied = len(data) if isinstance(data, bytes) else 0
        self.work += packet_work(len(packet), copied)
        # Both counters go on for a lost packet, so that the receiver sees the gap.
        self._sequence_count = (self._sequence_count + 1) & 0x3FFF
        self._message_counts[kind] = (self._message_counts[kind] + 1) & 0xFFFF
        limit = QUEUE_LIMIT_BYTES + (RESERVED_BYTES if definition.service in RESERVED_SERVICES else 0)
        queued_bytes = self._port.queue(packet, limit)
        if not queued_bytes:
            self.lost_packets += 1
            return False
        self.packets += 1
        self.bytes += queued_bytes
        if self.lost_packets and self.has_room:
            lost, self.lost_packets = self.lost_packets, 0
            self.on_lost(lost)
        return True
