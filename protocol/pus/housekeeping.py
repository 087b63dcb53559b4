"""Housekeeping parameter report structures of service 3: one table."""

from __future__ import annotations

from dataclasses import dataclass

from .enumerations import CanState, HousekeepingId, Mode, Reason, ResetCause, SelfTest, TimeStatus
from .field_types import INT16, INT32, UINT8, UINT16, UINT32
from .fields import Field

MIN_INTERVAL_MS = 250
MAX_INTERVAL_MS = 3_600_000


@dataclass(frozen=True)
class HousekeepingDefinition:
    """One structure: its number and the parameters it reports, in the order of the wire."""

    id: HousekeepingId
    meaning: str
    fields: tuple[Field, ...]

    @property
    def name(self) -> str:
        """Its name."""
        return self.id.name


HOUSEKEEPING_TABLE: tuple[HousekeepingDefinition, ...] = (
    HousekeepingDefinition(
        HousekeepingId.STATUS,
        "mode, start, time and frame statistics",
        (
            Field("mode", UINT8, meaning="present mode", choices=Mode),
            Field("reset_cause", UINT8, meaning="why the unit started", choices=ResetCause),
            Field("boot_count", UINT16, meaning="starts of the unit so far"),
            Field("uptime_ms", UINT32, "ms", meaning="time since the start"),
            Field("time_status", UINT8, meaning="time reference status", choices=TimeStatus),
            Field("self_test_result", UINT16, meaning="failed parts of the last self-test", choices=SelfTest),
            Field("last_frame_index", UINT32, meaning="index of the last frame that was started"),
            Field("last_reasons", UINT32, meaning="reasons of the last attitude report", choices=Reason),
            Field(
                "frames_processed", UINT32, meaning="frames processed; the counters here run as those of LINK"
            ),
            Field("frames_valid", UINT32, meaning="of those, frames with a valid attitude"),
            Field("frames_tracking", UINT32, meaning="of those, frames with a valid attitude from tracking"),
            Field("frames_late", UINT32, meaning="of those, frames that overran their budget"),
            Field("frames_dropped", UINT32, meaning="frames that were not processed"),
            Field("temperature_cdeg", INT16, "0.01 degC", meaning="detector temperature"),
            Field(
                "stored_parameters_valid", UINT8, "", 0, 1, "1: the stored parameters were whole at the start"
            ),
        ),
    ),
    HousekeepingDefinition(
        HousekeepingId.LINK,
        "counters of the command link since power-on, cold reset or CLEAR_COUNTERS; they stop at their "
        "highest value; tc_received is the sum of tc_accepted and tc_rejected",
        (
            Field("tc_received", UINT32, meaning="frames received, good or bad"),
            Field("tc_accepted", UINT32, meaning="telecommands accepted"),
            Field("tc_rejected", UINT32, meaning="telecommands rejected, for whatever reason"),
            Field("crc_errors", UINT16, meaning="packets with wrong packet error control"),
            Field("framing_errors", UINT16, meaning="frames with a bad escape sequence"),
            Field("length_errors", UINT16, meaning="packets of a wrong length or with a wrong header"),
            Field("oversized_frames", UINT16, meaning="frames longer than the receive buffer"),
            Field("unknown_apid", UINT16, meaning="packets for another application process"),
            Field("unknown_service", UINT16, meaning="telecommands of an unknown service or subservice"),
            Field("sequence_gaps", UINT16, meaning="gaps in the sequence count of a source"),
            Field("not_allowed_in_mode", UINT16, meaning="telecommands refused because of the mode"),
            Field("bad_parameters", UINT16, meaning="telecommands refused because of their application data"),
            Field("rx_bytes", UINT32, "byte", meaning="bytes received"),
            Field("tx_bytes", UINT32, "byte", meaning="bytes sent"),
            Field("tx_packets", UINT32, meaning="packets sent"),
            Field("tx_queue_bytes", UINT32, "byte", meaning="bytes waiting to be sent now"),
        ),
    ),
    HousekeepingDefinition(
        HousekeepingId.TIMING,
        "processor cycles of the last processed frame by stage",
        (
            Field("frame_index", UINT32, meaning="index of the frame"),
            Field("cycles_total", UINT32, "cycle", meaning="all stages"),
            Field("cycles_budget", UINT32, "cycle", meaning="available to the frame"),
            Field("cycles_threshold", UINT32, "cycle", meaning="background and threshold"),
            Field("cycles_clustering", UINT32, "cycle", meaning="run-length clustering"),
            Field("cycles_centroid", UINT32, "cycle", meaning="centroids"),
            Field("cycles_identification", UINT32, "cycle", meaning="star identification"),
            Field("cycles_tracking", UINT32, "cycle", meaning="prediction and verification of windows"),
            Field("cycles_attitude", UINT32, "cycle", meaning="attitude, residuals, covariance"),
            Field("cycles_telemetry", UINT32, "cycle", meaning="telemetry"),
            Field("margin_us", INT32, "us", meaning="time left at the end of processing; negative when late"),
            Field("worst_cycles", UINT32, "cycle", meaning="largest total since start or CLEAR_COUNTERS"),
            Field("clock_hz", UINT32, "Hz", meaning="clock of the processor"),
            Field("cycles_memory", UINT32, "cycle", meaning="of cycles_total, waiting for the memory"),
            Field("cache_kib", UINT8, "KiB", meaning="size of each cache, 0: caches off"),
            Field("line_fill", UINT8, meaning="time of a cache line's fill: 0 low, 1 nominal, 2 high"),
        ),
    ),
    HousekeepingDefinition(
        HousekeepingId.CAN,
        "CAN controller, bus load and transfers by ISO-TP; all 0 but can_state on the serial line",
        (
            Field("bitrate", UINT32, "bit/s", meaning="bit rate of the bus (of the arbitration)"),
            Field("bus_load", UINT16, "0.1 %", 0, 1000, "time in which the bus was busy, of the last second"),
            Field("can_state", UINT8, meaning="state of the controller", choices=CanState),
            Field("transmit_error_count", UINT16, meaning="transmit error counter of the controller"),
            Field("receive_error_count", UINT16, meaning="receive error counter of the controller"),
            Field("tx_frames", UINT32, meaning="frames sent; the counters here run as those of LINK"),
            Field("rx_frames", UINT32, meaning="frames received, of any identifier"),
            Field("error_frames", UINT16, meaning="error frames seen, own or of others"),
            Field("bus_off_count", UINT16, meaning="times that the controller went bus-off"),
            Field(
                "arbitration_lost", UINT32, meaning="times that a frame had to wait for a lower identifier"
            ),
            Field("tx_refused", UINT16, meaning="times that the link's own transmit queue was full"),
            Field(
                "cyclic_overruns",
                UINT16,
                meaning="cyclic frames thrown away because a newer one took their place",
            ),
            Field("pdus_sent", UINT32, meaning="telemetry packets sent whole"),
            Field("pdus_received", UINT32, meaning="telecommand packets received whole"),
            Field(
                "transmissions_failed", UINT16, meaning="telemetry packets that were given up on their way"
            ),
            Field("receptions_failed", UINT16, meaning="telecommand packets that were given up on their way"),
            Field(
                "frames_ignored", UINT16, meaning="frames on the telecommand identifier that made no sense"
            ),
            Field("timeouts_a", UINT16, meaning="of all these, TIMEOUT_A"),
            Field("timeouts_bs", UINT16, meaning="TIMEOUT_BS"),
            Field("timeouts_cr", UINT16, meaning="TIMEOUT_CR"),
            Field("wrong_sequence", UINT16, meaning="WRONG_SEQUENCE"),
            Field("unexpected_pdus", UINT16, meaning="UNEXPECTED_PDU"),
            Field(
                "flow_control_errors",
                UINT16,
                meaning="INVALID_FLOW_STATUS, WAIT_LIMIT and RECEIVER_OVERFLOW",
            ),
            Field("too_long", UINT16, meaning="TOO_LONG"),
            Field("bad_length", UINT16, meaning="BAD_LENGTH and BAD_PCI"),
            Field("syncs", UINT16, meaning="SYNC frames received"),
            Field(
                "syncs_ignored", UINT16, meaning="time_at_sync frames without their SYNC, or of wrong length"
            ),
        ),
    ),
)

HOUSEKEEPING: dict[int, HousekeepingDefinition] = {int(entry.id): entry for entry in HOUSEKEEPING_TABLE}
"""By number."""
