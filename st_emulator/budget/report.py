"""A budget as tables and as plain values: nothing in cycles or milliseconds without its bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ..report import Check
from .assessment import FLOWN, Assessment
from .memory import MIB
from .modes import LOST_IN_SPACE, TRACKING
from .sweeps import KINDS, PointResult
from .timeline import timelines
from .worst_case import AS_FLOWN, domain_text

MODELLED = (
    "every stage's work as the firmware model counts it, frame by frame, on rendered images",
    "core cycles of compiled reference kernels with the manual's timings and interlocks, by count of work",
    "instruction and data cache of the chosen size, line fills at the memory's low, nominal or high time",
    "the limit that the cycle budget sets to the search of lost in space",
    "the attitude report of each frame: packet, error control, time on the serial line",
)
NOT_MODELLED = (
    "the camera's DMA on the memory bus, TLB misses, a full write buffer, refresh",
    "interrupts and an operating system's own time, beyond the fixed cost of a frame",
    "telecommands and image downloads while a frame is worked on",
    "another compiler, other flags or a flight program of other authors: a factor of 2",
)


def checks(assessment: Assessment) -> list[Check]:
    """The requirements as checks: what decides the exit status."""
    found = [
        Check(item.name, item.time_ms.value, f"<= {item.budget_ms:g}", "ms", item.fits)
        for item in assessment.verdict.requirements
    ]
    memory = assessment.memory
    found.append(
        Check("memory", memory.total_bytes / MIB, f"<= {memory.available_bytes / MIB:g}", "MiB", memory.fits)
    )
    return found


def fits(assessment: Assessment) -> bool:
    """Time and memory."""
    return assessment.verdict.fits and assessment.memory.fits


def uncertainty_text(assessment: Assessment) -> str:
    """What the bounds are."""
    return f"Bounds: {assessment.subject.processor.uncertainty}."


def conditions_text(assessment: Assessment) -> str:
    """What was looked at."""
    order = assessment.order
    skies = (
        f"{order.n} random skies at rest"
        if order.scenario is None
        else f"{order.n} instants of {order.scenario.where}"
    )
    return f"{skies}, seed {order.seed}; each lost in space, then two frames tracked."


def figures(assessment: Assessment, command: str) -> dict[str, Any]:
    """Everything, for JSON."""
    order, subject = assessment.order, assessment.subject
    return {
        "command": command,
        **subject.identity(),
        "n": order.n,
        "seed": order.seed,
        "evaluations": order.evaluations,
        "scenario": None if order.scenario is None else order.scenario.where,
        "frame_period_ms": subject.period_ns / 1e6,
        "exposure_ms": subject.exposure_ns / 1e6,
        "readout_ms": subject.readout_ns / 1e6,
        "pipelined": subject.pipelined,
        "budget_cycles": subject.cycle_budget(subject.pipelined).cycles,
        "fits": fits(assessment),
        "verdict": assessment.verdict.as_dict() | {"text": assessment.verdict.text(subject)},
        "uncertainty": uncertainty_text(assessment),
        "accuracy_of_cycle_costs": subject.processor.table.accuracy,
        "modelled": list(MODELLED),
        "not_modelled": list(NOT_MODELLED),
        "lost_in_space": assessment.lost.as_dict(),
        "tracking": assessment.tracked.as_dict(),
        "worst_found_by_stage": {
            mode: {row: figure.as_dict() for row, figure in rows.items()}
            for mode, rows in assessment.worst_stages.items()
        },
        "sweeps": {name: _sweep(name, points) for name, points in assessment.sweeps.items()},
        "stops_fitting": [
            {
                "sweep": row.sweep,
                "mode": row.mode,
                "search": AS_FLOWN if row.cycles == FLOWN else "search without limit",
                "looked_at_to": row.last_value,
                "text": row.text(),
                **row.stop.as_dict(),
            }
            for row in assessment.stops
        ],
        "worst_cases": [case.as_dict(subject.changed) for case in assessment.worst],
        "worst_case_domain": domain_text(subject, order.scenario),
        "memory": assessment.memory.as_dict(),
        "transmission": asdict(assessment.transmission),
        "timelines": [line.as_dict() for line in timelines(assessment)],
    }


def _sweep(name: str, points: Sequence[PointResult]) -> dict[str, Any]:
    kind = KINDS[name]
    found = []
    for point in points:
        entry: dict[str, Any] = {"value": point.value}
        if LOST_IN_SPACE in kind.modes:
            entry["lost_in_space"] = point.lost.as_dict()
        if TRACKING in kind.modes:
            entry["tracking"] = point.tracked.as_dict() | {"holds": point.holds}
        found.append(entry)
    return {"unit": kind.unit, "meaning": kind.meaning, "points": found}


__all__ = [
    "MODELLED",
    "NOT_MODELLED",
    "checks",
    "conditions_text",
    "figures",
    "fits",
    "uncertainty_text",
]
