"""The unit's side of its wire: whole packets out, whole packets in, whatever carries them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from ..protocol.can.vocabulary import CanState, TransferFailure
from ..protocol.pus.enumerations import MalformedReason


class PortClient(Protocol):
    """What a port tells the unit. Nothing is told while the unit does not listen."""

    @property
    def listening(self) -> bool:
        """Whether the unit takes packets; not in BOOT and OFF, nor on its way there."""

    @property
    def silent(self) -> bool:
        """Whether the unit is in BOOT or OFF: it sends nothing, and its receiver is off."""

    def bytes_received(self, count: int) -> None:
        """So many bytes came in, good or bad: octets of the line, data octets of transfers on a CAN bus."""

    def packet_received(self, raw: bytes, last_bit_ns: int) -> None:
        """A whole packet, or what was sent in place of one; its last bit came in at the virtual time
        ``last_bit_ns``, now or just before.
        """

    def packet_discarded(self, reason: MalformedReason, length: int) -> None:
        """Bytes that the framing could not make a packet of."""


class CanObserver(Protocol):
    """What a CAN port tells beyond packets."""

    def message_received(self, name: str, fields: Mapping[str, Any], last_bit_ns: int) -> None:
        """A frame of the OBC that is no part of a packet (SYNC and its time); its last bit came in at the
        virtual time ``last_bit_ns``.
        """

    def frame_ignored(self) -> None:
        """A frame on an identifier of :meth:`message_received` whose length is wrong."""

    def transfer_failed(self, reason: TransferFailure) -> None:
        """A reception failed or a frame of one was ignored."""

    def packets_lost(self, reason: TransferFailure, packets: int) -> None:
        """The receiver takes packets again; so many were lost before. What is queued first during this call
        is the report: if it is lost as well, the next one counts the same packets again.
        """

    def state_changed(self, before: CanState, now: CanState) -> None:
        """The controller's state of fault confinement."""


class UnitPort(Protocol):
    """Queues packets towards the OBC and takes what arrives from it."""

    part_bytes: int
    """Image data of a packet (service 13)."""

    @property
    def queued_bytes(self) -> int:
        """Octets that wait, those on the wire included."""

    def queue(self, packet: bytes, limit_bytes: int) -> int:
        """Put a packet behind those that wait; returns its octets in the queue, 0 when the queue would then
        hold more than ``limit_bytes`` and the packet is lost.
        """

    def drain_ns(self, count: int) -> int:
        """Time after which ``count`` octets of the queue have left at the wire's full rate."""

    def restart(self) -> None:
        """As after power-on: what waits and what was half received is forgotten."""

    def where(self) -> str:
        """Rate and address, for people."""

    def arrive(self, data: bytes) -> None:
        """The link brought ``data`` at the present time."""
