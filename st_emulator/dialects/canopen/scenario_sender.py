"""The OBC that a scenario's telecommands stand for, on the card's bus."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from ...clock import NS_PER_S
from ...protocol.can.frames import CanFrame, RecordDecoder, encode_record
from ...protocol.canopen.network_management import COMMAND_IDENTIFIER
from ...protocol.canopen.node import SDO_TO_CLIENT, SDO_TO_SERVER

MOST_WAIT_NS = NS_PER_S  # ASSUMED: an OBC gives a transfer up that is not answered for so long


class CanopenSender:
    """Puts each frame on the bus; of a segmented transfer the next one when the card has answered the last.

    Args:
        encoded_for: the node that telecommands were encoded for.
        node: the node that the card is on this bus.
    """

    def __init__(self, encoded_for: int, node: int) -> None:
        self._encoded_for = encoded_for
        self._node = node
        self._sent = RecordDecoder()
        self._outbox: deque[bytes] = deque()
        self._behind_an_answer: deque[bytes] = deque()
        self._given_up_ns = 0

    def send(self, message: bytes, now_ns: int) -> None:
        first, *rest = [encode_record(self._addressed(one)) for one in RecordDecoder().receive(message)]
        self._outbox.append(first)
        if rest:
            self._behind_an_answer = deque(rest)
            self._given_up_ns = now_ns + MOST_WAIT_NS

    def _addressed(self, frame: CanFrame) -> CanFrame:
        """The frame as it is for the card's node."""
        if frame.identifier == SDO_TO_SERVER + self._encoded_for:
            return replace(frame, identifier=SDO_TO_SERVER + self._node)
        if frame.identifier == COMMAND_IDENTIFIER and frame.data[1:] == bytes((self._encoded_for,)):
            return replace(frame, data=frame.data[:1] + bytes((self._node,)))
        return frame

    def send_raw(self, octets: bytes, now_ns: int) -> None:
        """Octets of records, good or bad."""
        self._outbox.append(octets)

    def take(self, data: bytes, now_ns: int) -> None:
        for frame in self._sent.receive(data):
            if frame.identifier == SDO_TO_CLIENT + self._node and self._behind_an_answer:
                self._outbox.append(self._behind_an_answer.popleft())
                self._given_up_ns = now_ns + MOST_WAIT_NS

    def poll(self, now_ns: int) -> list[bytes]:
        if now_ns >= self._given_up_ns:
            self._behind_an_answer.clear()
        due = list(self._outbox)
        self._outbox.clear()
        return due

    def next_ns(self) -> int | None:
        if self._outbox:
            return 0
        return self._given_up_ns if self._behind_an_answer else None
