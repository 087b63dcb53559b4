"""Memory: the arrays' own sizes, frame buffers by hand, the paper's catalogue."""

from __future__ import annotations

import math

import pytest

from st_emulator.bench.star_tables import star_tables
from st_emulator.budget.memory import ASSUMED, MIB, memory_of, search_bytes
from st_emulator.budget.subject import Subject
from st_emulator.device.calibration import firmware_configuration
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.units.profile import load_unit

UNITS = ("roja1", "zy3", "aps_rs")


@pytest.mark.parametrize("name", UNITS)
def test_star_tables_are_the_models_arrays(name):
    unit = Subject(load_unit(name))
    tables = star_tables(unit.profile)
    found = {item.name.partition(",")[0]: item.nbytes for item in memory_of(unit).items}
    stars, pairs = len(tables.catalogue), len(tables.pairs)
    assert found["catalogue"] == stars * (4 + 3 * 8 + 4)
    assert found["pairs"] == pairs * (8 + 4 + 4)
    assert found["k-vector of the pairs"] == (pairs + 1) * 4
    cells = tables.catalogue.cells
    assert found["grid of the sky: which stars are near a direction"] == 4 * (
        stars + len(cells.cell_start) + len(cells.band_first_cell)
    )
    held = sum(array.nbytes for array in tables.arrays())
    counted = sum(item.nbytes for item in memory_of(unit).items if item.group == "star tables")
    scalars = 2 * 3 * 8  # limits beside the arrays, three of the catalogue and of the pairs
    references = tables.reference_pairs(3.0)
    extra = len(references) * 20 + 4 + 24 if name == "zy3" else 0
    assert counted == held - scalars + extra


def test_frame_buffers_two_when_pipelined():
    unit = Subject(load_unit("zy3"))
    both = {item.name: item.nbytes for item in memory_of(unit).items if "frame buffers" in item.name}
    assert list(both.values()) == [2 * 1024 * 1024 * 2]
    alone = memory_of(unit.with_parameters(pipelined=0))
    assert [i.nbytes for i in alone.items if "frame buffers" in i.name] == [1024 * 1024 * 2]
    assert memory_of(unit).total_bytes - alone.total_bytes == 1024 * 1024 * 2


def test_the_total_is_the_sum_and_what_is_assumed_is_marked():
    memory = memory_of(Subject(load_unit("roja1")))
    assert memory.total_bytes == sum(item.nbytes for item in memory.items)
    assert memory.available_bytes == 64 * MIB
    assumed = {item.name for item in memory.items if item.basis == ASSUMED}
    assert assumed == {"program and constants", "stacks", "link buffers"}
    assert memory.as_dict()["total_bytes"]["high"] == memory.total_bytes + memory.assumed_bytes


def test_a_unit_with_too_little_memory_does_not_fit():
    profile = load_unit("roja1")
    small = profile.model_copy(
        update={"processor": profile.processor.model_copy(update={"memory_mbyte": 8.0})}
    )
    assert not memory_of(Subject(small)).fits
    memory = memory_of(Subject(profile))
    assert memory.fits
    assert memory.fits_at_bound


def test_the_papers_catalogue():
    """Pairs within twice the field, counted over the whole sky: what the estimate is held to."""
    unit = Subject(load_unit("roja1"))
    paper = memory_of(unit).paper
    assert paper.paper_bytes / paper.paper_pairs == 19
    stars = len(star_tables(unit.profile).catalogue)
    evenly = stars * (stars - 1) / 2 * (1 - math.cos(math.radians(paper.wide_angle_deg))) / 2
    # stars crowd along the Milky Way: more pairs than of an even sky, by a sixth at most
    assert evenly < paper.wide_pairs < 1.17 * evenly
    assert paper.wide_bytes == pytest.approx(20 * paper.wide_pairs, rel=1e-4)
    assert paper.total_with_papers_bytes == (
        memory_of(unit).total_bytes - len(star_tables(unit.profile).pairs) * 20 - 28 + 38_000_000
    )
    assert "38 MB" in paper.text()


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_tables_of_a_search(algorithm):
    profile = load_unit("zy3")
    unit = Subject(profile)
    size = search_bytes(algorithm, star_tables(profile), firmware_configuration(profile, unit.parameters))
    stars = len(star_tables(profile).catalogue)
    assert 4 * stars < size < 4 * MIB
    if algorithm == "geometric_voting":
        assert size >= 60 * stars * 4  # a vote of each of 60 spots for each star
