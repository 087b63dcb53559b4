"""The identification algorithms with 0, 1, 10 and 50 false stars, in a wide and in a narrow field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from ..firmware_model.catalogue.tables import StarTables
from ..firmware_model.identification.algorithms import ALGORITHMS
from ..firmware_model.identification.interface import IdentificationParameters
from ..report import TextTable, check
from .campaign import CampaignRequest, CampaignResult
from .confidence import share
from .star_identification import LABELS, SUCCESS, Attempt, attempts, pair_tolerance_rad
from .star_scenes import SceneSettings, make_scene, scene_tables, square_field_normals

FALSE_STARS = (0, 1, 10, 50)
MOST_SPOTS = 100  # all of them: of the 20 brightest nearly all may be false
BATCH = 10
ATTITUDES = 200  # what the targets are of
PIXELS = 1024  # of a side of the detector
NOISE_PX = 0.07  # 5 arcsec in the wide field
RESOLUTION_PX = 3.0


@dataclass(frozen=True)
class Field:
    """A square field with the catalogue that a unit of its class has.

    targets: how many of 200 attitudes have to be right at each number of false stars.
    """

    name: str
    field_deg: float
    limit_mag: float
    targets: tuple[int, ...]

    @property
    def pixel_arcsec(self) -> float:
        """In the middle of the image."""
        return math.degrees(2 * math.tan(math.radians(self.field_deg / 2)) / PIXELS) * 3600

    @property
    def noise_arcsec(self) -> float:
        """One sigma of a direction, each axis."""
        return NOISE_PX * self.pixel_arcsec

    def tables(self) -> StarTables:
        """Catalogue, and the pairs that fit into the field's diagonal."""
        diagonal = 2 * math.degrees(math.atan(math.sqrt(2) * math.tan(math.radians(self.field_deg / 2))))
        return scene_tables(self.limit_mag, diagonal, round(RESOLUTION_PX * self.pixel_arcsec, 1))


FIELDS = (
    Field("20 deg", 20.0, 5.5, (200, 200, 200, 199)),  # the catalogue of Zhang et al. 2014
    Field(
        "7.5 deg", 7.5, 6.9, (199, 199, 198, 190)
    ),  # the catalogue of Sarvi et al. 2014, whose field is near it
)


@dataclass(frozen=True)
class Case:
    """An attitude with false stars in a field; the attitude and the true stars depend on number alone."""

    field: int
    false_stars: int
    number: int


def look(seed: int, case: Case) -> tuple[Attempt, ...]:
    """Every algorithm on the scene of a case."""
    field = FIELDS[case.field]
    tables = field.tables()
    settings = SceneSettings(field.field_deg, noise_arcsec=field.noise_arcsec, false_stars=case.false_stars)
    scene = make_scene(tables.catalogue, settings, seed, case.number)
    parameters = IdentificationParameters(
        tolerance_rad=pair_tolerance_rad(field.noise_arcsec),
        max_spots=MOST_SPOTS,
        field_normals=square_field_normals(field.field_deg),
    )
    return attempts(scene, tables, parameters)


@dataclass(frozen=True)
class Cell:
    """An algorithm in a field with a number of false stars.

    right: valid attitudes with every star right. wrong: valid attitudes that are not right.
    """

    right: int
    wrong: int
    cases: int
    operations: float
    time_ms: float
    worst_ms: float


def _cell(tried: Sequence[Attempt]) -> Cell:
    valid = [item for item in tried if item.confirmed]
    right = sum(item.verdict == SUCCESS for item in valid)
    times = [item.time_ns / 1e6 for item in tried]
    operations = sum(item.operations for item in tried) / len(tried)
    return Cell(right, len(valid) - right, len(tried), operations, sum(times) / len(times), max(times))


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` attitudes in each field with each number of false stars."""
    cases = [
        Case(field, false, number)
        for field in range(len(FIELDS))
        for false in FALSE_STARS
        for number in range(request.n)
    ]
    outcomes = request.workers.map(partial(look, request.seed), cases, batch=BATCH)
    cells: dict[tuple[str, int, int], Cell] = {}
    for order, name in enumerate(ALGORITHMS):
        for field in range(len(FIELDS)):
            for false in FALSE_STARS:
                tried = [
                    outcome[order]
                    for case, outcome in zip(cases, outcomes, strict=True)
                    if (case.field, case.false_stars) == (field, false)
                ]
                cells[name, field, false] = _cell(tried)
    best = best_algorithm(cells)
    checks = []
    for place, field_ in enumerate(FIELDS):
        for false, target in zip(FALSE_STARS, field_.targets, strict=True):
            least = request.n - math.floor((ATTITUDES - target) * request.n / ATTITUDES)
            right = cells[best, place, false].right
            checks.append(check(f"right: {field_.name}, {false} false", right, ">=", least, "attitudes"))
    wrong = sum(cell.wrong for (name, _, _), cell in cells.items() if name == best)
    checks.append(check(f"wrong: {LABELS.get(best, best)}", wrong, "==", 0, "attitudes"))
    others = sum(cell.wrong for cell in cells.values()) - wrong
    checks.append(check("wrong: the others", others, "==", 0, "attitudes"))
    figures = {
        "best": best,
        "rows": [
            {
                "algorithm": name,
                "field": FIELDS[place].name,
                "false_stars": false,
                "right": cell.right,
                "right_interval": [share(cell.right, cell.cases).low, share(cell.right, cell.cases).high],
                "wrong": cell.wrong,
                "cases": cell.cases,
                "operations": cell.operations,
            }
            for (name, place, false), cell in cells.items()
        ],
    }
    timing = {
        f"{name} / {FIELDS[place].name} / {false} false": {"mean_ms": cell.time_ms, "worst_ms": cell.worst_ms}
        for (name, place, false), cell in cells.items()
    }
    return CampaignResult(figures, checks, _tables(cells), timing, partial(draw, cells))


def best_algorithm(cells: dict[tuple[str, int, int], Cell]) -> str:
    """The fewest wrong attitudes over all fields, then the most right ones, then the fewest operations."""

    def merit(name: str) -> tuple[float, ...]:
        own = [cell for (other, _, _), cell in cells.items() if other == name]
        return (
            -sum(cell.wrong for cell in own),
            sum(cell.right for cell in own),
            -sum(cell.operations for cell in own),
        )

    return max(ALGORITHMS, key=merit)


def _tables(cells: dict[tuple[str, int, int], Cell]) -> list[TextTable]:
    columns = ("false", "algorithm", "right", "95 %", "wrong", "steps", "ms", "worst")
    tables = []
    for place, field in enumerate(FIELDS):
        rows: list[tuple[str, ...]] = []
        for false, target in zip(FALSE_STARS, field.targets, strict=True):
            rows.append((str(false), "target", f"{target}/{ATTITUDES}", "", "0", "", "", ""))
            for name in ALGORITHMS:
                cell = cells[name, place, false]
                rows.append(
                    (
                        "",
                        LABELS.get(name, name),
                        f"{cell.right}/{cell.cases}",
                        share(cell.right, cell.cases).interval(1),
                        str(cell.wrong),
                        f"{cell.operations:.0f}",
                        f"{cell.time_ms:.2f}",
                        f"{cell.worst_ms:.1f}",
                    )
                )
        tables.append(TextTable(f"{field.name} field, stars to {field.limit_mag} mag", columns, tuple(rows)))
    return tables


def draw(cells: dict[tuple[str, int, int], Cell], figure: Any) -> None:
    """Share of right attitudes with its interval, and operations, over the number of false stars."""
    from .plotting import COLOURS, SOURCE_COLOUR  # the workers draw nothing

    all_axes = figure.subplots(2, len(FIELDS), sharex=True)
    for place, field in enumerate(FIELDS):
        above, below = all_axes[0][place], all_axes[1][place]
        for order, name in enumerate(ALGORITHMS):
            places = [at + 0.08 * (order - 1.5) for at in range(len(FALSE_STARS))]
            shares = [
                share(cells[name, place, false].right, cells[name, place, false].cases)
                for false in FALSE_STARS
            ]
            values = [100 * item.value for item in shares]
            errors = [
                [100 * (item.value - item.low) for item in shares],
                [100 * (item.high - item.value) for item in shares],
            ]
            colour = COLOURS[order % len(COLOURS)]
            above.errorbar(
                places, values, yerr=errors, fmt="o", markersize=4, capsize=3, color=colour, label=name
            )
            below.plot(
                places,
                [cells[name, place, false].operations for false in FALSE_STARS],
                "o-",
                markersize=4,
                color=colour,
            )
        above.plot(
            range(len(FALSE_STARS)),
            [100 * item / ATTITUDES for item in field.targets],
            "_",
            markersize=28,
            color=SOURCE_COLOUR,
            label="target",
        )
        above.set_title(f"{field.name} field, stars to {field.limit_mag} mag")
        above.set_ylabel("right, %")
        below.set_ylabel("operations")
        below.set_yscale("log")
        below.set_xticks(range(len(FALSE_STARS)), [str(item) for item in FALSE_STARS])
        below.set_xlabel("false stars")
        for axes in (above, below):
            axes.grid(axis="y", alpha=0.4)
    handles, labels = all_axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, ncols=len(labels), loc="outside lower center")
