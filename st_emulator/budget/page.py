"""A budget as one self-contained page: verdict, pictures, tables, and what the figures hold."""

from __future__ import annotations

import base64
import json
from importlib import resources
from pathlib import Path

import jinja2

from ..errors import ConfigurationError
from . import drawing, report, tables
from .assessment import Assessment
from .modes import LOST_IN_SPACE, TRACKING
from .timeline import timelines
from .worst_case import ISLANDS, domain_text, inputs_of


def require_page_path(path: Path) -> None:
    """See before the work that the page can be written. ConfigurationError: it cannot."""
    if path.is_dir():
        raise ConfigurationError(f"--html {path}: is a folder")
    if not path.absolute().parent.is_dir():
        raise ConfigurationError(f"--html {path}: there is no folder {path.parent}")


def write_page(path: Path, assessment: Assessment, command: str) -> None:
    """Write the page. ConfigurationError: the file cannot be written."""
    text = page(assessment, command)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"--html {path}: cannot be written: {error.strerror}") from error


def page(assessment: Assessment, command: str) -> str:
    """The page's HTML; it needs no other file."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(
        (resources.files(__package__) / "page.html.jinja").read_text(encoding="utf-8")
    )
    subject, verdict = assessment.subject, assessment.verdict
    colour = "bad"
    if report.fits(assessment):
        colour = "good" if verdict.fits_at_bound and assessment.memory.fits_at_bound else "unsure"
    lines = timelines(assessment)
    domains = domain_text(subject, assessment.order.scenario)
    return template.render(
        unit=subject.profile.name,
        title=subject.profile.unit.title,
        word=f"{subject.profile.name} {verdict.word}",
        verdict=verdict.text(subject),
        colour=colour,
        conditions=report.conditions_text(assessment),
        uncertainty=report.uncertainty_text(assessment),
        accuracy=subject.processor.table.accuracy,
        requirements=tables.requirement_table(assessment),
        timelines=_embedded(
            drawing.svg(lambda figure: drawing.draw_timelines(figure, lines), (12.0, 2.9 * len(lines)))
        ),
        baud=subject.profile.wire.baud,
        can_frames=assessment.transmission.can_frames,
        can_ms=f"{assessment.transmission.can_ns / 1e6:.2f}",
        stages=_embedded(drawing.svg(lambda figure: drawing.draw_stages(figure, assessment), (12.0, 4.6))),
        cycles=[tables.cycle_table(assessment, mode) for mode in (LOST_IN_SPACE, TRACKING)],
        margins=tables.margin_table(assessment),
        margin_plot=_embedded(
            drawing.svg(lambda figure: drawing.draw_margins(figure, assessment), (12.0, 4.8))
        ),
        budget=f"{assessment.lost.flown.margin.budget_ms:g}",
        stops=tables.stop_table(assessment),
        sweeps=[tables.sweep_table(assessment, name) for name in assessment.sweeps],
        search=(
            f"{assessment.order.evaluations} skies at most, from the heaviest of those above, in {ISLANDS} "
            f"evolutions for each row, seed {assessment.order.seed}. Lost in space: "
            f"{domains[LOST_IN_SPACE]}. Tracking: {domains[TRACKING]}."
        ),
        worst=tables.worst_table(assessment),
        inputs=[
            {
                "title": case.objective.title,
                "json": json.dumps(inputs_of(case.place, case.frame, subject.changed), indent=1),
            }
            for case in assessment.worst
        ],
        memory=tables.memory_table(assessment),
        paper=assessment.memory.paper.text(),
        modelled=report.MODELLED,
        not_modelled=report.NOT_MODELLED,
        provenance={"command": command, **subject.identity()},
    )


def _embedded(picture: bytes) -> str:
    """A picture inside the page."""
    return "data:image/svg+xml;base64," + base64.b64encode(picture).decode()
