"""Results of commands: figures, the checks that they are held to, JSON and tables."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from .errors import ConfigurationError

Direction = Literal["<=", ">=", "=="]


@dataclass(frozen=True)
class Check:
    """One figure against its target: ``holds`` says whether ``value`` meets it."""

    name: str
    value: float | int | bool | None
    target: str
    unit: str
    holds: bool


@dataclass(frozen=True)
class TextTable:
    """A table to be printed: its title, the columns' heads, and rows of texts."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def check(
    name: str, value: float | int | None, direction: Direction, target: float | int, unit: str
) -> Check:
    """``value`` against ``target``; a figure that could not be measured (None or NaN) does not hold."""
    holds = False
    if value is not None:
        holds = {"<=": value <= target, ">=": value >= target, "==": value == target}[direction]
    return Check(name, value, f"{direction} {target:g}", unit, bool(holds))


def all_hold(checks: Sequence[Check]) -> bool:
    return all(item.holds for item in checks)


def require_json_path(path: str | Path | None) -> None:
    """See before the work that its figures can be written afterwards.

    Raises:
        ConfigurationError: ``--json`` names a folder, or a file where no file can be.
    """
    if path is None or str(path) == "-":
        return
    target = Path(path)
    if target.is_dir():
        reason = "is a folder"
    elif not target.absolute().parent.is_dir():
        reason = f"there is no folder {target.parent}"
    elif not os.access(target if target.exists() else target.absolute().parent, os.W_OK):
        reason = "permission denied"
    else:
        return
    raise ConfigurationError(f"--json {path}: cannot be written: {reason}")


def plain(value: Any) -> Any:
    """``value`` as JSON holds it: numpy's numbers as Python's; what is no finite number is null."""
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path: str | Path | None, figures: dict[str, Any], checks: Sequence[Check]) -> None:
    """Write figures and checks as JSON; ``-`` is standard output, None nothing."""
    if path is None:
        return
    contents = plain(figures | {"checks": [asdict(item) for item in checks]})
    text = json.dumps(contents, indent=2, allow_nan=False) + "\n"
    if str(path) == "-":
        print(text, end="")
        return
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"--json {path}: cannot be written: {error.strerror}") from error


def show_checks(console: Console, checks: Sequence[Check]) -> None:
    """Print the checks as a table."""
    table = Table(title="Checks", title_justify="left")
    for column in ("figure", "measured", "target", "unit", ""):
        table.add_column(column)
    for item in checks:
        value = (
            "none"
            if item.value is None
            else f"{item.value:.6g}"
            if isinstance(item.value, float)
            else str(item.value)
        )
        table.add_row(
            escape(item.name),
            escape(value),
            item.target,
            escape(item.unit),
            "[green]holds[/]" if item.holds else "[red]falls short[/]",
        )
    console.print(table)


def show_table(console: Console, contents: TextTable) -> None:
    """Print a table; columns of figures are aligned to the right."""
    table = Table(title=escape(contents.title), title_justify="left")
    for number, column in enumerate(contents.columns):
        table.add_column(escape(column), justify="left" if number == 0 else "right")
    for row in contents.rows:
        table.add_row(*map(escape, row))
    console.print(table)


def show_figures(console: Console, title: str, figures: dict[str, Any]) -> None:
    """Print plain figures as a table of two columns."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column("figure")
    table.add_column("value")
    for name, value in figures.items():
        if isinstance(value, (list, dict)):
            continue
        table.add_row(escape(name), f"{value:.6g}" if isinstance(value, float) else escape(str(value)))
    console.print(table)
