"""What the dialect does on a CAN bus beyond packets: cyclic frames, SYNC and time, reports of the bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...clock import NS_PER_MS, NS_PER_S
from ...device.commands import RefusedError, SetTime
from ...device.counters import saturated
from ...device.star_tracker import StarTracker
from ...protocol.can.vocabulary import CanState, TransferFailure
from ...protocol.pus.enumerations import EventId, TimeStatus
from ...protocol.pus.packets import CucTime
from ...wire.can.port import CanPort
from .reception import RaiseEvent
from .time_code import cuc_at

REPORT_INTERVAL_NS = NS_PER_S
FRACTION_PER_S = 1 << 24
SYNC_VALID_NS = NS_PER_S  # ASSUMED: a time that follows its SYNC later than this is not its
FLOW_CONTROL_ERRORS = (
    TransferFailure.INVALID_FLOW_STATUS,
    TransferFailure.WAIT_LIMIT,
    TransferFailure.RECEIVER_OVERFLOW,
)
WIDE = ("tx_frames", "rx_frames", "arbitration_lost", "pdus_sent", "pdus_received")


class CyclicFrames:
    """The unit's part on its CAN port beside packets; the port tells it what happens there."""

    def __init__(self, device: StarTracker, port: CanPort, raise_event: RaiseEvent) -> None:
        self._device = device
        self._port = port
        self._raise_event = raise_event
        self._settings = device.profile.can
        self._heartbeats = 0
        self._latched: tuple[int, int] | None = None  # counter of the last SYNC, virtual time of its last bit
        self._syncs = 0
        self._syncs_ignored = 0
        self._failures = 0
        self._failure_reason = TransferFailure.ABORTED
        self._report_pending = False
        self._bus_off_ns: int | None = None
        self._baseline: dict[str, int] = {}
        port.observe(self)

    def reset(self) -> None:
        """The unit starts anew."""
        self._heartbeats = 0
        self._latched = None
        self._failures = 0
        self._report_pending = False
        self._bus_off_ns = None

    def start(self) -> None:
        """The boot is over: the receiver is on, heartbeats from now on."""
        self._port.listen()
        if self._settings.heartbeat_ms:
            self._heartbeat()

    def clear_counters(self) -> None:
        """Count from 0."""
        self._baseline = {}
        self._baseline = self._counts()

    # -- cyclic frames
    # ----------------------------------------------------------------------------------------------

    def _heartbeat(self) -> None:
        device = self._device
        fields = {
            "counter": self._heartbeats & 0xFF,
            "mode": int(device.mode),
            "attitude_valid": int(device.attitude_valid),
            "time_set": int(device.time.synchronised),
            "can_state": int(self._port.bus.state),
            "boot_count": device.parameters.boot_count & 0xFF,
            "uptime_s": device.uptime_ms // 1000 & 0xFFFFFFFF,
        }
        self._port.send_message("heartbeat", fields)
        self._heartbeats += 1
        device.later(self._settings.heartbeat_ms * NS_PER_MS, self._heartbeat)

    def report_attitude(self, report: Mapping[str, Any]) -> None:
        """The cyclic frames of a frame whose attitude report has the fields ``report``."""
        index, settings = int(report["frame_index"]), self._settings
        counter = {"counter": index & 0xFF}
        time: CucTime = report["mid_exposure_time"]

        def due(interval: int) -> bool:
            return interval > 0 and index % interval == 0

        if due(settings.attitude_frames):
            self._send("attitude_1", counter, report, ("q_x", "q_y"))
            self._send("attitude_2", counter, report, ("q_z", "q_w"))
        if due(settings.rates_frames):
            self._send("rates", counter, report, ("rate_valid", "rate_x", "rate_y", "rate_z"))
        if due(settings.status_frames):
            time_set = {"time_set": int(report["time_status"] == TimeStatus.SET)}
            names = ("mode", "valid", "rate_valid", "late", "reasons")
            counts = ("stars_identified", "spots_detected", "frames_dropped_before")
            self._send("status", counter | time_set, report, names + counts)
        if due(settings.time_frames):
            self._port.send_message("mid_exposure_time", counter | _seconds(time))

    def _send(
        self, name: str, beside: Mapping[str, int], report: Mapping[str, Any], fields: tuple[str, ...]
    ) -> None:
        self._port.send_message(name, {**beside, **{field: report[field] for field in fields}})

    # -- the port's observer
    # --------------------------------------------------------------------------------------------

    def message_received(self, name: str, fields: Mapping[str, Any], last_bit_ns: int) -> None:
        device = self._device
        counter = int(fields["sync_counter"])
        if name == "sync":
            self._syncs += 1
            self._latched = (counter, last_bit_ns)
            time = _seconds(cuc_at(device, last_bit_ns))
            self._port.send_message("sync_time", {"sync_counter": counter, **time})
            return
        latched = self._latched
        if latched is None or latched[0] != counter or last_bit_ns - latched[1] > SYNC_VALID_NS:
            self._syncs_ignored += 1
            return
        at_sync = CucTime(int(fields["seconds"]), round(fields["fraction"] * FRACTION_PER_S))
        wanted = SetTime(at_sync.to_ns(), latched[1])
        try:
            device.check(wanted)
        except RefusedError:
            self._syncs_ignored += 1
            return
        device.execute(wanted)

    def frame_ignored(self) -> None:
        self._syncs_ignored += 1

    def transfer_failed(self, reason: TransferFailure) -> None:
        self._failures += 1
        self._failure_reason = reason
        if not self._report_pending:
            self._report_failures()

    def _report_failures(self) -> None:
        """One event now, and at most one each second while failures go on."""
        self._report_pending = self._failures > 0
        if self._failures:
            count, self._failures = self._failures, 0
            self._raise_event(
                EventId.CAN_TRANSFER_FAILED, reason=int(self._failure_reason), count=saturated(count, 16)
            )
            self._device.later(REPORT_INTERVAL_NS, self._report_failures)

    def packets_lost(self, reason: TransferFailure, packets: int) -> None:
        self._raise_event(EventId.CAN_PACKETS_LOST, reason=int(reason), packets=saturated(packets, 16))

    def state_changed(self, before: CanState, now: CanState) -> None:
        device, bus = self._device, self._port.bus
        if now == CanState.BUS_OFF:
            self._bus_off_ns = device.clock.now_ns
        elif before == CanState.BUS_OFF:
            since_ns = device.clock.now_ns if self._bus_off_ns is None else self._bus_off_ns
            self._raise_event(
                EventId.CAN_BUS_OFF_RECOVERED,
                duration_ms=saturated((device.clock.now_ns - since_ns) // NS_PER_MS, 32),
                count=saturated(self._counts()["bus_off_count"], 16),
            )
        elif now == CanState.ERROR_PASSIVE:
            self._raise_event(
                EventId.CAN_ERROR_PASSIVE_ENTERED,
                transmit_errors=saturated(bus.transmit_error_count, 16),
                receive_errors=saturated(bus.receive_error_count, 16),
            )

    # -- housekeeping
    # -----------------------------------------------------------------------------------------------

    def _counts(self) -> dict[str, int]:
        """Every counter of the structure, since the last clearing."""
        bus, transport = self._port.bus.counters, self._port.connection.counters
        reasons = transport.by_reason

        def of(*failures: TransferFailure) -> int:
            return sum(reasons.get(failure, 0) for failure in failures)

        counts = {
            "tx_frames": bus.tx_frames,
            "rx_frames": bus.rx_frames,
            "error_frames": bus.error_frames,
            "bus_off_count": bus.bus_off_count,
            "arbitration_lost": bus.arbitration_lost,
            "tx_refused": bus.tx_refused,
            "cyclic_overruns": self._port.counters.cyclic_overruns,
            "pdus_sent": transport.pdus_sent,
            "pdus_received": transport.pdus_received,
            "transmissions_failed": transport.transmissions_failed,
            "receptions_failed": transport.receptions_failed,
            "frames_ignored": transport.frames_ignored,
            "timeouts_a": of(TransferFailure.TIMEOUT_A),
            "timeouts_bs": of(TransferFailure.TIMEOUT_BS),
            "timeouts_cr": of(TransferFailure.TIMEOUT_CR),
            "wrong_sequence": of(TransferFailure.WRONG_SEQUENCE),
            "unexpected_pdus": of(TransferFailure.UNEXPECTED_PDU),
            "flow_control_errors": of(*FLOW_CONTROL_ERRORS),
            "too_long": of(TransferFailure.TOO_LONG),
            "bad_length": of(TransferFailure.BAD_LENGTH, TransferFailure.BAD_PCI),
            "syncs": self._syncs,
            "syncs_ignored": self._syncs_ignored,
        }
        return {name: count - self._baseline.get(name, 0) for name, count in counts.items()}

    def housekeeping(self) -> dict[str, int]:
        """The values of housekeeping structure CAN."""
        bus = self._port.bus
        return {
            "bitrate": self._port.settings.bus.bitrate,
            "bus_load": bus.load_permille,
            "can_state": int(bus.state),
            "transmit_error_count": saturated(bus.transmit_error_count, 16),
            "receive_error_count": saturated(bus.receive_error_count, 16),
        } | {name: saturated(count, 32 if name in WIDE else 16) for name, count in self._counts().items()}


def _seconds(time: CucTime) -> dict[str, float]:
    return {"seconds": time.coarse, "fraction": time.fine / FRACTION_PER_S}
