"""What an OBC counts on its wire."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from ..protocol.pus.enumerations import TransferFailure


@dataclass
class Counters:
    """What has happened on the wire since the link was opened. All count from 0 and never wrap."""

    received_bytes: int = 0
    """Bytes that the link brought; on a CAN bus its records, 8 bytes and the frame's data each."""
    packets: int = 0
    startup_fragments: int = 0
    """A frame that was under way when the link was opened (at most one): not an error."""
    framing_errors: int = 0
    crc_errors: int = 0
    malformed: int = 0
    """Frames that are no telemetry packet for another reason than CRC, unknown messages not included."""
    unknown: int = 0
    """Packets of a service, subservice or structure that this interface does not define."""
    other_apid: int = 0
    """Packets of another application process than the one asked for."""
    sequence_gaps: int = 0
    missing_packets: int = 0
    restarts: int = 0
    """Sequence counts that began again at 0 out of turn."""
    sent_bytes: int = 0
    telecommands_sent: int = 0
    telecommands_verified: int = 0
    telecommands_failed: int = 0
    telecommands_timed_out: int = 0
    unmatched_verifications: int = 0
    """Verification reports of telecommands that this OBC did not send, or no longer waits for."""

    def as_dict(self) -> dict[str, int]:
        """Name to count."""
        return asdict(self)


@dataclass
class CanCounters(Counters):
    """On a CAN bus, the same and its frames and transfers. Transfers that failed and frames that changed
    nothing are counted once more under their reason (`timeout_bs` and so on).
    """

    telecommands_not_delivered: int = 0
    """Telecommands that the unit did not take off the bus."""
    frames_received: int = 0
    """Every frame of the bus, those of others included."""
    frames_sent: int = 0
    frames_refused: int = 0
    """Attempts to send that the link could not take; they are repeated."""
    frames_lost: int = 0
    """Frames given up because the link took none of them in time."""
    frames_of_others: int = 0
    """Frames that are none of the unit's telemetry: of other nodes, other OBCs and remote frames."""
    error_frames: int = 0
    """Error messages of the CAN interface."""
    malformed_records: int = 0
    """Records of the link that no frame can have."""
    cyclic_frames: int = 0
    cyclic_malformed: int = 0
    """Cyclic frames of a wrong length."""
    transfers_received: int = 0
    transfers_sent: int = 0
    receptions_failed: int = 0
    transmissions_failed: int = 0
    transfer_frames_ignored: int = 0
    flow_controls_sent: int = 0
    wait_frames_received: int = 0
    timeout_a: int = 0
    timeout_bs: int = 0
    timeout_cr: int = 0
    wrong_sequence: int = 0
    unexpected_pdu: int = 0
    invalid_flow_status: int = 0
    wait_limit: int = 0
    receiver_overflow: int = 0
    too_long: int = 0
    bad_length: int = 0
    bad_pci: int = 0
    aborted: int = 0

    def count(self, reason: TransferFailure) -> None:
        """One more failure or ignored frame for this reason."""
        name = reason.name.lower()
        setattr(self, name, getattr(self, name) + 1)
