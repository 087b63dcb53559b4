"""The values of the housekeeping structures; every value fits its field."""

from __future__ import annotations

from ...clock import NS_PER_S
from ...device.counters import saturated
from ...device.imaging import microseconds
from ...device.star_tracker import StarTracker
from ...firmware_model.cycle_table import LINE_FILLS
from ...firmware_model.work import STAGES
from ...protocol.pus.enumerations import CanState, HousekeepingId
from ...protocol.pus.housekeeping import HOUSEKEEPING
from ...wire.port import UnitPort
from .reception import LinkCounters
from .time_code import time_status
from .transmission import Transmitter

WIDE = ("tc_received", "tc_accepted", "tc_rejected", "rx_bytes")


def status_values(device: StarTracker) -> dict[str, int]:
    """Structure STATUS."""
    counters = device.frame_counters
    return {
        "mode": int(device.mode),
        "reset_cause": int(device.reset_cause),
        "boot_count": saturated(device.parameters.boot_count, 16),
        "uptime_ms": device.uptime_ms & 0xFFFFFFFF,  # a clock: it turns over after 49 days
        "time_status": int(time_status(device)),
        "self_test_result": int(device.self_test.result),
        "last_frame_index": device.last_frame_index & 0xFFFFFFFF,
        "last_reasons": int(device.last_reasons),
        "frames_processed": saturated(counters.frames_processed, 32),
        "frames_valid": saturated(counters.frames_valid, 32),
        "frames_tracking": saturated(counters.frames_tracking, 32),
        "frames_late": saturated(counters.frames_late, 32),
        "frames_dropped": saturated(counters.frames_dropped, 32),
        "temperature_cdeg": device.temperature_cdeg,
        "stored_parameters_valid": int(device.parameters.fault_at_start is None),
    }


def link_values(counters: LinkCounters, transmitter: Transmitter, port: UnitPort) -> dict[str, int]:
    """Structure LINK."""
    values = {
        name: saturated(getattr(counters, name), 32 if name in WIDE else 16)
        for name in counters.__dataclass_fields__
    }
    return values | {
        "tx_bytes": saturated(transmitter.bytes, 32),
        "tx_packets": saturated(transmitter.packets, 32),
        "tx_queue_bytes": port.queued_bytes,
    }


def timing_values(device: StarTracker) -> dict[str, int]:
    """Structure TIMING: of the last processed frame; before the first one, budget and clock of the next."""
    record = device.last_frame
    settings = record.settings if record is not None else device.parameters.frame_settings()
    budget_cycles = device.imaging.budget_cycles(settings)
    worst_cycles = device.frame_counters.worst_cycles
    processor = settings.processor
    cycles = record.cycles if record is not None else None
    by_stage = cycles.by_stage if cycles is not None else dict.fromkeys(STAGES, 0)
    total = cycles.total if cycles is not None else 0
    parts = processor.parts(record.work) if record is not None and record.work is not None else {}
    margin_us = microseconds((budget_cycles - total) * NS_PER_S // processor.clock_hz)
    return {f"cycles_{stage}": saturated(by_stage[stage], 32) for stage in STAGES} | {
        "frame_index": record.index if record is not None else 0,
        "cycles_total": saturated(total, 32),
        "cycles_budget": saturated(budget_cycles, 32),
        "margin_us": max(-(1 << 31), min(margin_us, (1 << 31) - 1)),
        "worst_cycles": saturated(worst_cycles, 32),
        "clock_hz": processor.clock_hz,
        "cycles_memory": saturated(round(sum(memory for _, memory in parts.values())), 32),
        "cache_kib": processor.cache_kib,
        "line_fill": LINE_FILLS.index(processor.line_fill),
    }


def no_bus_values() -> dict[str, int]:
    """Structure CAN on the serial line: there is no bus, and nothing is counted."""
    fields = HOUSEKEEPING[int(HousekeepingId.CAN)].fields
    return dict.fromkeys((field.name for field in fields), 0) | {"can_state": int(CanState.NOT_USED)}
