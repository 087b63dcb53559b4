"""What a calibration found, as tables on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from st_emulator.firmware_model.work import COUNTS
from tools.calibration.validation import FRAME_LIMIT, STAGE_LIMIT

__all__ = ["show_document", "show_errors"]


def show_document(console: Console, document: Mapping[str, Any]) -> None:
    """Coefficients and errors."""
    table = Table(title=f"Cycles of one of each count: {document['compiler']}", title_justify="left")
    for column in ("stage", "count", "core", "sigma", "fills 32 KiB", "sigma", "fills 4 KiB", "evidence"):
        table.add_column(column, justify="left" if column in ("stage", "count", "evidence") else "right")
    stage = ""
    for name, definition in COUNTS.items():
        entry = document["counts"][name]
        table.add_row(
            definition.stage if definition.stage != stage else "",
            name,
            f"{entry['core_cycles']:.5g}",
            f"{entry['core_sigma']:.2g}",
            f"{entry['line_fills']['32']:.3g}",
            f"{entry['line_fills_sigma']['32']:.2g}",
            f"{entry['line_fills']['4']:.3g}",
            entry["evidence"],
        )
        stage = definition.stage
    console.print(table)
    show_errors(console, document)
    console.print(document["accuracy"], markup=False, soft_wrap=True)


def show_errors(console: Console, document: Mapping[str, Any]) -> None:
    """Errors of the predictions: frames of the fit and held out, by stage, and whole frames."""
    table = Table(title="Error of the predicted cycles, 32 KiB caches", title_justify="left")
    for column in ("", "frames", "under 0.1 ms", "median", "p95", "worst", "bias", "limit"):
        table.add_column(column, justify="left" if not column else "right")
    for title, key, limit in (
        ("fit", "residuals", STAGE_LIMIT),
        ("held out", "held_out", STAGE_LIMIT),
        ("held out, whole frame", "frame_held_out", FRAME_LIMIT),
    ):
        for name, item in document[key].items():
            shares = [f"{item[part]:.1%}" for part in ("median", "p95", "worst")]
            missed = item["worst"] > limit
            table.add_row(
                f"{title}: {name.replace('_', ' ')}",
                str(item["frames"]),
                str(item["short"] or ""),
                *shares,
                f"{item['bias']:+.1%}",
                f"{limit:.0%}",
                style="red" if missed else None,
            )
    console.print(table)
