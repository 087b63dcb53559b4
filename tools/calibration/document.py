"""The committed figures: ``firmware_model/cycle_costs/arm926ej_s.json``, written and read.

The same samples give the same bytes: keys sorted, figures rounded, no date and no name of a machine.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.cycle_table import MemoryTiming
from st_emulator.firmware_model.work import COUNTS
from tools.calibration.compiler import Build
from tools.calibration.fit import Fit
from tools.calibration.frames import LOST_IN_SPACE, TRACKING
from tools.calibration.samples import (
    CACHES_KIB,
    TARGETS,
    Sample,
    class_totals,
    fills_target,
    frames_of,
)
from tools.calibration.validation import (
    Errors,
    by_kind,
    by_stage,
    errors_by_cache,
    frame_errors,
    stage_errors,
)

__all__ = [
    "ASSUMED",
    "COMMITTED",
    "Assumption",
    "SampleSet",
    "document_of",
    "predictor",
    "read_document",
    "rounded",
    "text_of",
]

NAME: Final = "arm926ej_s"
COMMITTED: Final = Path(__file__).parents[2] / "firmware_model" / "cycle_costs" / f"{NAME}.json"
CLOCK_HZ: Final = 400_000_000
CORE_UNCERTAINTY: Final = 0.10
_FIGURES, _SIGMA_FIGURES = 5, 2  # significant digits


@dataclass(frozen=True)
class Assumption:
    """A count that no kernel stands for. One sigma: half of it, as it may be wrong by a factor of two."""

    core_cycles: float
    line_fills: float
    accesses: float
    reason: str


ASSUMED: Final[Mapping[str, Assumption]] = {
    "frames": Assumption(
        200_000.0,
        400.0,
        200_000.0,
        "interrupts, mode logic, housekeeping: half a millisecond at 400 MHz; no kernel stands for a flight "
        "program's operating system",
    )
}


@dataclass(frozen=True)
class SampleSet:
    """Samples of a set of sequences; left_out: (sequence, frame) without their identification."""

    samples: Sequence[Sample]
    left_out: frozenset[tuple[int, int]] = frozenset()

    @property
    def frames(self) -> int:
        """Frames, without what was identified by another algorithm beside."""
        return sum(own[0].kind in (LOST_IN_SPACE, TRACKING) for own in frames_of(self.samples).values())


def rounded(value: float, figures: int = _FIGURES) -> float:
    """A value to so many significant figures, far fewer than what another machine's rounding changes."""
    if value == 0 or not math.isfinite(value):
        return 0.0
    return float(f"{value:.{figures - 1}e}")


def document_of(build: Build, found: Fit, fitted: SampleSet, held_out: SampleSet) -> dict[str, Any]:
    """The whole document. ConfigurationError: a count that no sample has and that is not assumed."""
    missing = sorted(COUNTS.keys() - found.coefficients.keys() - ASSUMED.keys())
    if missing:
        raise ConfigurationError(
            f"counts that no frame of the calibration has: {', '.join(missing)}; each needs frames or "
            "records that have it, or a reason among the assumed ones (tools/calibration/document.py)"
        )
    memory = MemoryTiming()
    counts = {name: _assumed(ASSUMED[name]) for name in ASSUMED}
    counts |= {
        name: _calibrated(found, name, fitted.samples) for name in found.coefficients if name not in ASSUMED
    }
    document: dict[str, Any] = {
        "name": NAME,
        "processor": "ARM926EJ-S, instruction and data cache of 32 KiB each, 4-way, lines of 32 bytes",
        "clock_hz": CLOCK_HZ,
        "compiler": build.compiler,
        "flags": list(build.flags),
        "binaries": dict(build.sha256),
        "memory": {
            "line_fill_ns": dict(memory.line_fill_ns),
            "access_ns": dict(memory.access_ns),
            "caches_kib": [*CACHES_KIB, 0],
            "source": "line fill: 24, 48 and 72 cycles at 400 MHz, derived from a bus of 133 MHz with DDR2, "
            "not measured; ASSUMED: a single access takes the time to the first word of a burst",
        },
        "model_uncertainty": {
            "core": CORE_UNCERTAINTY,
            "source": "ASSUMED: some rows of the manual's table are not published and taken from similar "
            "ones; Dhrystone 2.1 and the delay loop of BogoMIPS come within this of published figures",
        },
        "not_modelled": "contention with the camera's DMA, TLB, write-buffer saturation, interrupts beyond "
        "the figure per frame",
        "counts": counts,
        "class_counts": class_totals(fitted.samples),
        "instructions_checked": {
            "count": sum(s.value("instructions") for s in (*fitted.samples, *held_out.samples)),
            "source": "every call's instructions were counted one by one and by the blocks that the "
            "simulator ran: the two agree",
        },
        "errors": "of core and memory cycles, 32 KiB caches, nominal line fill; of a stage under 0.1 ms "
        "relative to 0.1 ms",
        "collinear": [str(item) for item in found.collinear],
        "frames": {"fitted": fitted.frames, "held_out": held_out.frames},
    }
    predict = predictor(document)
    document["residuals"] = _dicts(by_stage(stage_errors(fitted.samples, predict)))
    document["held_out"] = _dicts(by_stage(stage_errors(held_out.samples, predict)))
    document["held_out_by_cache_kib"] = {
        str(kib): _dicts(errors) for kib, errors in errors_by_cache(held_out.samples, predict).items()
    }
    document["frame_held_out"] = _dicts(by_kind(frame_errors(held_out.samples, predict, held_out.left_out)))
    document["accuracy"] = _accuracy(document)
    return document


def _dicts(errors: Mapping[str, Errors]) -> dict[str, Any]:
    return {name: item.as_dict() for name, item in errors.items()}


def _accuracy(document: Mapping[str, Any]) -> str:
    stages = max(item["worst"] for item in document["held_out"].values())
    frames = [
        f"{item['worst']:.1%} {kind.replace('_', ' ')}" for kind, item in document["frame_held_out"].items()
    ]
    fills = "/".join(
        f"{value * 1e-9 * CLOCK_HZ:.0f}" for value in document["memory"]["line_fill_ns"].values()
    )
    return (
        f"counts times coefficients are within {stages:.1%} of the simulated program for each stage and "
        f"within {' and '.join(frames)} for whole frames, on frames that the fit had not seen; the simulated "
        f"core's cycles are good to about {CORE_UNCERTAINTY:.0%}, a line fill takes {fills} cycles "
        "(low/nominal/high, derived); not validated on hardware; a flight program of other authors: a factor "
        "of 2"
    )


def _calibrated(found: Fit, name: str, samples: Sequence[Sample]) -> dict[str, Any]:
    estimates = found.coefficients[name]
    families = sorted({sample.step for sample in samples if name in dict(sample.counts)})
    fills = {str(kib): estimates[fills_target(kib)] for kib in CACHES_KIB}
    core = estimates["core_cycles"]
    return {
        "core_cycles": rounded(core.value),
        "core_sigma": rounded(core.sigma, _SIGMA_FIGURES),
        "line_fills": {kib: rounded(item.value) for kib, item in fills.items()},
        "line_fills_sigma": {kib: rounded(item.sigma, _SIGMA_FIGURES) for kib, item in fills.items()},
        "accesses": rounded(estimates["accesses"].value),
        "instructions": rounded(estimates["instructions"].value),
        "evidence": "calibrated",
        "source": f"{', '.join(families)}: {found.frames[name]} frames",
    }


def _assumed(item: Assumption) -> dict[str, Any]:
    sizes = [str(kib) for kib in CACHES_KIB]
    return {
        "core_cycles": item.core_cycles,
        "core_sigma": item.core_cycles / 2,
        "line_fills": dict.fromkeys(sizes, item.line_fills),
        "line_fills_sigma": dict.fromkeys(sizes, item.line_fills / 2),
        "accesses": item.accesses,
        "instructions": item.core_cycles,
        "evidence": "assumed",
        "source": item.reason,
    }


def predictor(document: Mapping[str, Any]) -> Any:
    """Sample -> each target of ``TARGETS`` by the document's coefficients.

    KeyError when called with a sample of a count that the document has not.
    """
    table: dict[str, list[float]] = {}
    for name, entry in document["counts"].items():
        values = {key: float(entry[key]) for key in ("core_cycles", "instructions", "accesses")}
        values |= {fills_target(int(kib)): float(value) for kib, value in entry["line_fills"].items()}
        table[name] = [values[target] for target in TARGETS]

    def predict(sample: Sample) -> dict[str, float]:
        sums = [0.0] * len(TARGETS)
        for name, number in sample.counts:
            for place, value in enumerate(table[name]):
                sums[place] += number * value
        return dict(zip(TARGETS, sums, strict=True))

    return predict


def text_of(document: Mapping[str, Any]) -> str:
    """The document as it is committed."""
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def read_document(path: Path) -> dict[str, Any]:
    """A document from a file. ConfigurationError: it cannot be read, or lacks what a check needs."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}") from error
    except json.JSONDecodeError as error:
        raise ConfigurationError(f"{path}: line {error.lineno}: {error.msg}") from error
    needed: Iterable[str] = ("binaries", "compiler", "flags", "counts")
    lacking = [key for key in needed if not isinstance(document, dict) or key not in document]
    if lacking:
        raise ConfigurationError(
            f"{path}: no figures of tools/calibrate_cycles: {', '.join(lacking)} missing"
        )
    return document
