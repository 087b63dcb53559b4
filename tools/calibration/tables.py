"""What a calibration found, as tables on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from st_emulator.firmware_model.work import COUNTS, STAGES
from tools.calibration.frames import LOST_IN_SPACE, TRACKING
from tools.calibration.validation import FRAME_LIMIT, STAGE_LIMIT

__all__ = ["show_document", "show_errors"]

_STYLE: Any = {"box": SIMPLE_HEAD, "pad_edge": False, "padding": (0, 1, 0, 0)}


def show_document(console: Console, document: Mapping[str, Any]) -> None:
    """Coefficients and errors."""
    table = Table(
        title=f"Cycles of one of each count: {document['compiler']}", title_justify="left", **_STYLE
    )
    table.add_column("count", no_wrap=True)
    for column in ("core", "sigma", "fills 32K", "sigma", "fills 4K"):
        table.add_column(column, justify="right", no_wrap=True)
    stage = ""
    for name, definition in COUNTS.items():
        entry = document["counts"][name]
        if definition.stage != stage:
            table.add_row(f"[bold]{definition.stage}[/]")
        table.add_row(
            name if entry["evidence"] == "calibrated" else f"{name} ({entry['evidence']})",
            f"{entry['core_cycles']:.4g}",
            f"{entry['core_sigma']:.1g}",
            f"{entry['line_fills']['32']:.3g}",
            f"{entry['line_fills_sigma']['32']:.1g}",
            f"{entry['line_fills']['4']:.3g}",
        )
        stage = definition.stage
    console.print(table)
    show_errors(console, document)
    console.print(document["accuracy"], markup=False, soft_wrap=True)


def show_errors(console: Console, document: Mapping[str, Any]) -> None:
    """Errors of the predictions: frames of the fit and held out, by stage, and whole frames."""
    table = Table(title="Errors of the predicted cycles, 32 KiB caches", title_justify="left", **_STYLE)
    table.add_column("", no_wrap=True)
    for column in ("set", "frames", "short", "median", "p95", "worst", "bias", "limit"):
        table.add_column(column, justify="left" if column == "set" else "right", no_wrap=True)
    for title, key, names, limit in (
        ("fit", "residuals", STAGES, STAGE_LIMIT),
        ("held out", "held_out", STAGES, STAGE_LIMIT),
        ("held out", "frame_held_out", (LOST_IN_SPACE, TRACKING), FRAME_LIMIT),
    ):
        for name in names:
            if name not in document[key]:
                continue
            item = document[key][name]
            shares = [f"{item[part]:.1%}" for part in ("median", "p95", "worst")]
            table.add_row(
                f"frame, {name.replace('_', ' ')}" if key == "frame_held_out" else name,
                title,
                str(item["frames"]),
                str(item["short"] or ""),
                *shares,
                f"{item['bias']:+.1%}",
                f"{limit:.0%}",
                style="red" if item["worst"] > limit else None,
            )
    console.print(table)
    console.print("short: frames in which the stage takes under 0.1 ms; its error is relative to that.")
