"""Brightness-referenced, geometric voting and multi-poles on the ARM: their room to work in, and the calls.

They join the kernels of ``identification.py``, which has the step and compares.
"""

from __future__ import annotations

from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.identification import brightness_referenced, geometric_voting, multi_poles
from st_emulator.firmware_model.identification.interface import (
    Identification,
    IdentificationParameters,
    Spikes,
)
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps.identification import (
    KERNELS,
    MOST_PATTERN_SPIKES,
    KernelRun,
    place_limits,
    place_pair_table,
    place_spikes,
    place_star_table,
    read_identification,
)
from tools.calibration.struct_layout import layout_of, place_struct, reserve_structs

__all__ = [
    "brightness_referenced_kernel",
    "geometric_voting_kernel",
    "multi_poles_kernel",
    "place_brightness_parameters",
    "place_poles_parameters",
]

MOST_VOTING_SPIKES = 128  # geometric_voting.h
MOST_IDENTITIES = 32  # geometric_voting.h
# Entries of a mark table for each spike: a range of the widest tolerances has some hundreds of pairs, and two
# entries each. The kernels say when they do not suffice.
_ENTRIES_OF_A_SPIKE = 8192
_MOST_ENTRIES = 1 << 21
_WORD_BYTES = 4


def place_brightness_parameters(machine: ArmMachine, parameters: IdentificationParameters) -> int:
    """An st_brightness_parameters."""
    return place_struct(
        machine,
        "st_brightness_parameters",
        distinct_mag=parameters.brightness.distinct_mag,
        bright_limit_mag=parameters.brightness.bright_limit_mag,
        max_spots=parameters.max_spots,
    )


def place_poles_parameters(machine: ArmMachine, parameters: IdentificationParameters) -> int:
    """An st_poles_parameters."""
    return place_struct(
        machine,
        "st_poles_parameters",
        magnitude_tolerance=parameters.multi_poles.magnitude_tolerance,
        least_recognised=parameters.multi_poles.least_recognised,
    )


def brightness_referenced_kernel(
    machine: ArmMachine, spikes: Spikes, tables: StarTables, parameters: IdentificationParameters
) -> KernelRun:
    """``brightness_referenced.identify`` without limits of work."""
    if parameters.max_spots > MOST_PATTERN_SPIKES:
        raise ValueError(f"max_spots {parameters.max_spots}, but the kernel holds {MOST_PATTERN_SPIKES}")
    brightness = parameters.brightness
    entries = min(_ENTRIES_OF_A_SPIKE * min(len(spikes), parameters.max_spots), _MOST_ENTRIES)
    marks = place_struct(
        machine,
        "st_brightness_marks",
        mark=reserve_structs(machine, "st_brightness_mark", len(tables.catalogue)),
        entry=reserve_structs(machine, "st_brightness_entry", entries),
        entries=entries,
        pivots=0,
    )
    return _call(
        machine,
        "st_identify_brightness_referenced",
        spikes,
        place_star_table(machine, tables.catalogue),
        place_pair_table(machine, tables.pairs),
        place_pair_table(machine, tables.reference_pairs(float(brightness.bright_limit_mag))),
        place_limits(machine, parameters, tables.pairs),
        place_brightness_parameters(machine, parameters),
        marks,
    )


def geometric_voting_kernel(
    machine: ArmMachine, spikes: Spikes, tables: StarTables, parameters: IdentificationParameters
) -> KernelRun:
    """``geometric_voting.identify`` without limits of work."""
    if parameters.max_spots > MOST_VOTING_SPIKES:
        raise ValueError(f"max_spots {parameters.max_spots}, but the kernel holds {MOST_VOTING_SPIKES}")
    voters = min(len(spikes), MOST_VOTING_SPIKES)
    identities = voters * MOST_IDENTITIES
    words = identities * -(-identities // 32)
    layout = layout_of(machine, "st_voting_room")
    room = place_struct(
        machine,
        "st_voting_room",
        votes=machine.reserve(layout.items_bytes("votes", voters * (len(tables.catalogue) + 1))),
        fits=machine.reserve(layout.items_bytes("fits", words)),
        words=words,
    )
    return _call(
        machine,
        "st_identify_geometric_voting",
        spikes,
        place_star_table(machine, tables.catalogue),
        place_pair_table(machine, tables.pairs),
        place_limits(machine, parameters, tables.pairs),
        parameters.max_spots,
        room,
    )


def multi_poles_kernel(
    machine: ArmMachine, spikes: Spikes, tables: StarTables, parameters: IdentificationParameters
) -> KernelRun:
    """``multi_poles.identify`` without limits of work."""
    entries = min(_ENTRIES_OF_A_SPIKE * len(spikes), _MOST_ENTRIES)
    marks = place_struct(
        machine,
        "st_poles_marks",
        mark=reserve_structs(machine, "st_poles_mark", len(tables.catalogue)),
        entry=reserve_structs(machine, "st_poles_entry", entries),
        entries=entries,
        base=1,
        sets=machine.reserve(_WORD_BYTES * len(spikes) ** 2),
    )
    return _call(
        machine,
        "st_identify_multi_poles",
        spikes,
        place_star_table(machine, tables.catalogue),
        place_pair_table(machine, tables.pairs),
        place_limits(machine, parameters, tables.pairs),
        place_poles_parameters(machine, parameters),
        marks,
    )


def _call(machine: ArmMachine, symbol: str, spikes: Spikes, *arguments: int) -> KernelRun:
    """One identification; the kernel's last two arguments are the places of what it finds."""
    found = reserve_structs(machine, "st_identification")
    star_index = machine.reserve(_WORD_BYTES * len(spikes))
    call = machine.call(symbol, place_spikes(machine, spikes), *arguments, found, star_index)
    if not call.result:
        raise ValueError(f"{symbol}: {len(spikes)} spikes need a larger mark table")
    identification: Identification = read_identification(machine, found, star_index, len(spikes))
    return KernelRun(identification, call.cost)


KERNELS[brightness_referenced.identify] = brightness_referenced_kernel
KERNELS[geometric_voting.identify] = geometric_voting_kernel
KERNELS[multi_poles.identify] = multi_poles_kernel
