"""The identifications on the ARM: star tables, limits and spikes into its memory, the outcome compared.

``KERNELS`` has a kernel for each algorithm; the module that has another algorithm's kernel adds it there. All
run without a limit of work, since calibration wants the whole of it: where a record's search had one, the
Python algorithm is run once more without.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.catalogue.pairs import PairCatalogue
from st_emulator.firmware_model.catalogue.star_catalogue import StarCatalogue
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.identification import pyramid
from st_emulator.firmware_model.identification.interface import (
    Identification,
    IdentificationAlgorithm,
    IdentificationParameters,
    Spikes,
)
from st_emulator.firmware_model.identification.verification import separation_kernel
from st_emulator.firmware_model.reasons import Reason
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import place_struct, read_struct, reserve_structs

__all__ = [
    "KERNELS",
    "MOST_SPIKES",
    "QUATERNION_BOUND",
    "STEPS",
    "IdentificationKernel",
    "IdentifyStep",
    "KernelRun",
    "compare",
    "place_limits",
    "place_pair_table",
    "place_spikes",
    "place_star_table",
    "placed_cells",
    "read_identification",
    "unlimited",
]

MOST_SPIKES = 1024  # identification.h
MOST_PATTERN_SPIKES = 64  # pyramid.h
QUATERNION_BOUND = 1e-9  # largest difference of an element; the trial attitudes are the same to rounding
_CHANCE_BOUND = 1e-6  # relative, of false_solutions: an exponential of logarithms of the gamma function
_NO_LIMIT = 1 << 62
_WORD_BYTES = 4


@dataclass(frozen=True)
class KernelRun:
    """What a kernel found, its star_index with it, and what it cost."""

    found: Identification
    cost: Cost


IdentificationKernel = Callable[[ArmMachine, Spikes, StarTables, IdentificationParameters], KernelRun]


def unlimited(parameters: IdentificationParameters) -> IdentificationParameters:
    """The same parameters without any limit of work."""
    return replace(
        parameters,
        max_triads=_NO_LIMIT,
        max_pairs_compared=_NO_LIMIT,
        max_operations=_NO_LIMIT,
        max_cycles=math.inf,
        count_cycles=None,
    )


def placed_cells(machine: ArmMachine, catalogue: StarCatalogue) -> dict[str, float]:
    """The members of an st_sky_cells; the tables themselves are placed once and stay."""
    cells = catalogue.cells
    return {
        "band_height_rad": cells.band_height_rad,
        "bands": len(cells.band_first_cell) - 1,
        "band_first_cell": machine.place(cells.band_first_cell, keep=True),
        "cell_start": machine.place(cells.cell_start, keep=True),
        "cell_star": machine.place(cells.cell_star, keep=True),
        "unit_vectors": machine.place(catalogue.unit_vectors, keep=True),
    }


def place_star_table(machine: ArmMachine, catalogue: StarCatalogue) -> int:
    """An st_star_table with its room for rows; the tables themselves are placed once and stay."""
    return place_struct(
        machine,
        "st_star_table",
        cells=placed_cells(machine, catalogue),
        hp_mag=machine.place(catalogue.hp_mag, keep=True),
        stars=len(catalogue),
        near=machine.reserve(_WORD_BYTES * len(catalogue)),
    )


def place_pair_table(machine: ArmMachine, pairs: PairCatalogue) -> int:
    """An st_pair_table; the tables themselves are placed once and stay."""
    return place_struct(
        machine,
        "st_pair_table",
        slope=pairs.kvector.slope,
        offset=pairs.kvector.offset,
        steps_per_unit=1.0 / pairs.kvector.slope,
        cos_angle=machine.place(pairs.cos_angle, keep=True),
        brighter=machine.place(pairs.brighter, keep=True),
        dimmer=machine.place(pairs.dimmer, keep=True),
        count_below=machine.place(pairs.kvector.count_below, keep=True),
        pairs=len(pairs),
    )


def place_limits(machine: ArmMachine, parameters: IdentificationParameters, pairs: PairCatalogue) -> int:
    """An st_limits."""
    normals = parameters.normals
    return place_struct(
        machine,
        "st_limits",
        tolerance_rad=parameters.tolerance_rad,
        separation_rad=float(separation_kernel(pairs.cos_angle)),
        least_seen_share=parameters.least_seen_share,
        magnitude_tolerance=parameters.magnitude_tolerance,
        most_false_solutions=parameters.most_false_solutions,
        most_false_triangles=parameters.most_false_triangles,
        certain_false_solutions=parameters.certain_false_solutions,
        normals=normals.ravel() if len(normals) else np.zeros(12),
        min_stars=parameters.min_stars,
        field_given=len(normals) == 4,
    )


def place_spikes(machine: ArmMachine, spikes: Spikes) -> int:
    """An st_spikes with its arrays. ValueError: more spikes than the kernels' tables hold."""
    if len(spikes) > MOST_SPIKES:
        raise ValueError(f"{len(spikes)} spikes, but the kernels hold {MOST_SPIKES}")
    b = np.ascontiguousarray(spikes.b_vectors, np.float64)
    magnitudes = np.ascontiguousarray(spikes.magnitudes, np.float64)
    return place_struct(
        machine,
        "st_spikes",
        b=machine.place(b),
        magnitudes=machine.place(magnitudes),
        count=len(spikes),
    )


def read_identification(machine: ArmMachine, found: int, star_index: int, spikes: int) -> Identification:
    """The st_identification at ``found`` with its int32[spikes] at ``star_index``."""
    told = read_struct(machine, "st_identification", found)
    return Identification(
        star_index=machine.read(star_index, np.int32, spikes),
        verified=int(told["verified"]),
        reason=Reason(int(told["reason"])),
        q_icrs_to_sensor=told["q"].copy() if told["verified"] else None,
        false_solutions=float(told["false_solutions"]),
        expected=int(told["expected"]),
        seen=int(told["seen"]),
    )


def pyramid_kernel(
    machine: ArmMachine, spikes: Spikes, tables: StarTables, parameters: IdentificationParameters
) -> KernelRun:
    """``pyramid.identify`` without limits of work."""
    if parameters.max_spots > MOST_PATTERN_SPIKES:
        raise ValueError(f"max_spots {parameters.max_spots}, but the kernel holds {MOST_PATTERN_SPIKES}")
    entries = 2 * len(tables.pairs)
    marks = place_struct(
        machine,
        "st_pyramid_marks",
        head=machine.reserve(_WORD_BYTES * len(tables.catalogue)),
        partner=machine.reserve(_WORD_BYTES * entries),
        chain=machine.reserve(_WORD_BYTES * entries),
        entries=entries,
        base=1,
    )
    found = reserve_structs(machine, "st_identification")
    star_index = machine.reserve(_WORD_BYTES * len(spikes))
    call = machine.call(
        "st_identify_pyramid",
        place_spikes(machine, spikes),
        place_star_table(machine, tables.catalogue),
        place_pair_table(machine, tables.pairs),
        place_limits(machine, parameters, tables.pairs),
        parameters.max_spots,
        marks,
        found,
        star_index,
    )
    return KernelRun(read_identification(machine, found, star_index, len(spikes)), call.cost)


KERNELS: dict[IdentificationAlgorithm, IdentificationKernel] = {pyramid.identify: pyramid_kernel}


def compare(found: Identification, expected: Identification) -> None:
    """MismatchError unless two identifications are the same, attitudes within ``QUATERNION_BOUND``."""
    for name in ("reason", "verified", "expected", "seen"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        if ours != theirs:
            raise MismatchError(f"identify: {name} is {ours}, {theirs} in Python")
    if not np.array_equal(found.star_index, expected.star_index):
        raise MismatchError(f"identify: star_index is {found.star_index}, {expected.star_index} in Python")
    if (found.q_icrs_to_sensor is None) != (expected.q_icrs_to_sensor is None):
        raise MismatchError("identify: an attitude on one side alone")
    if not math.isclose(found.false_solutions, expected.false_solutions, rel_tol=_CHANCE_BOUND):
        raise MismatchError(
            f"identify: false_solutions {found.false_solutions}, {expected.false_solutions} in Python"
        )
    if found.q_icrs_to_sensor is None or expected.q_icrs_to_sensor is None:
        return
    off = _largest(found.q_icrs_to_sensor - expected.q_icrs_to_sensor)
    if not off <= QUATERNION_BOUND:
        raise MismatchError(f"identify: quaternion is off by {off:.3g}, {QUATERNION_BOUND:.3g} are allowed")


def _largest(values: npt.NDArray[np.float64]) -> float:
    return float(np.max(np.abs(values)))


class IdentifyStep:
    """Lost in space, by whichever algorithm the record had."""

    name = "identify"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run of the stage identification, its attitudes' counts included.

        None for too few spikes: the call returns at once, and its few lines are filled or not by chance.
        """
        algorithm = record.arguments["algorithm"]
        spikes, tables = record.arguments["spikes"], record.arguments["tables"]
        parameters = unlimited(record.arguments["parameters"])
        expected, work = algorithm(spikes, tables, parameters)
        if record.result.reason != Reason.WORK_LIMIT:
            compare(record.result, expected)  # the limit must have changed nothing
        try:
            ran = KERNELS[algorithm](machine, spikes, tables, parameters)
        finally:
            machine.release()
        compare(ran.found, expected)
        if expected.reason == Reason.TOO_FEW_STARS:
            return []
        return [StageRun(self.name, "identification", ran.cost, work)]


STEPS = (IdentifyStep(),)
