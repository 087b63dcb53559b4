"""Housekeeping of the processor's time: cycles of the last frame by stage, and what was left."""

from __future__ import annotations

from ...clock import NS_PER_S
from ...device.counters import saturated
from ...device.imaging import FrameRecord, FrameSettings, microseconds
from ...firmware_model.cycle_table import LINE_FILLS
from ...firmware_model.work import STAGES


def timing_fields(
    record: FrameRecord | None, settings: FrameSettings, budget_cycles: int, worst_cycles: int
) -> dict[str, int]:
    """Fields of structure TIMING: of the frame, or of none yet; every value fits its field."""
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
