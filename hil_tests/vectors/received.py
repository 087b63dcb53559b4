"""Telemetry that came, read by the reference decoder, and the interface document's numbers to ask it by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

FUNCTION = {
    "GO_STANDBY": 1, "START_ACQUISITION": 2, "START_SELF_TEST": 3, "RESET": 4, "CAPTURE_IMAGE": 5,
    "DOWNLOAD_IMAGE": 6, "ABORT_DOWNLOAD": 7, "SHUTDOWN": 8, "CLEAR_COUNTERS": 9,
    "RESTORE_DEFAULT_PARAMETERS": 10, "TRACK_FROM": 11,
}  # fmt: skip
EVENT = {
    "BOOT_COMPLETED": 1, "MODE_CHANGED": 2, "SELF_TEST_COMPLETED": 3, "FRAME_OVERRAN": 4, "FRAME_DROPPED": 5,
    "TRACKING_LOST": 6, "ATTITUDE_ACQUIRED": 7, "TC_CRC_FAILED": 8, "TC_MALFORMED": 9,
    "TC_SEQUENCE_GAP_DETECTED": 10, "SENSOR_BLINDED": 11, "TIME_SET": 12, "FAULT_ENTERED": 13,
    "PARAMETER_STORE_INVALID": 14, "IMAGE_CAPTURED": 15, "IMAGE_DOWNLOAD_ABORTED": 16,
    "PARAMETERS_STORED": 17, "SHUTDOWN_STARTED": 18, "TX_QUEUE_OVERFLOWED": 19,
    "CAN_ERROR_PASSIVE_ENTERED": 20, "CAN_BUS_OFF_RECOVERED": 21, "CAN_TRANSFER_FAILED": 22,
    "CAN_PACKETS_LOST": 23,
}  # fmt: skip
VERIFICATION = {
    "acceptance_success", "acceptance_failure", "start_success", "start_failure", "progress",
    "progress_failure", "completion_success", "completion_failure", "routing_failure",
}  # fmt: skip


@dataclass(frozen=True)
class Packet:
    """A telemetry packet; ``t_ns``: when it had left the unit, or had come to the OBC."""

    t_ns: int
    decoded: dict[str, Any]

    @property
    def name(self) -> str:
        return self.decoded["name"]

    @property
    def fields(self) -> dict[str, Any]:
        return self.decoded["fields"]


class Received:
    """What is asked of the packets that came."""

    packets: Sequence[Packet]

    def reports(self, count: int) -> list[Packet]:
        """The verification reports of one telecommand."""
        return [
            packet
            for packet in self.packets
            if packet.name in VERIFICATION and packet.fields["request_id"]["sequence_count"] == count
        ]

    def stages(self, count: int) -> list[str]:
        return [packet.name for packet in self.reports(count)]

    def failure(self, count: int) -> tuple[str, int, int]:
        """(report, failure code, failure data) of a telecommand that ended in a single failure."""
        (report,) = [packet for packet in self.reports(count) if "failure_code" in packet.fields]
        return report.name, report.fields["failure_code"], report.fields["failure_data"]

    def of(self, name: str) -> list[dict[str, Any]]:
        """The fields of all packets of a message."""
        return [packet.fields for packet in self.packets if packet.name == name]

    def events(self, name: str) -> list[dict[str, Any]]:
        """The data of all events of a kind."""
        return [
            packet.fields["data"]
            for packet in self.packets
            if packet.decoded["service"] == 5 and packet.fields.get("event_id") == EVENT[name]
        ]
