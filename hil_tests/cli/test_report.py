"""Figures and checks on their way to JSON and to tables."""

from __future__ import annotations

import json

import numpy as np
import pytest
from rich.console import Console

from st_emulator.report import all_hold, check, plain, show_checks, show_figures, write_json


def test_json_holds_no_numbers_that_json_does_not_know(tmp_path):
    path = tmp_path / "out.json"
    figures = {
        "nan": float("nan"),
        "inside": [{"inf": -np.inf, "many": np.array([1.5, np.nan])}],
        "whole": np.int64(3),
        "truth": np.bool_(True),
        "tuple": (np.float32(0.5), None, "text"),
    }
    write_json(path, figures, [check("x", float("inf"), "<=", 2, "px")])
    text = path.read_text()

    def refuse(word: str) -> None:
        raise AssertionError(word)

    assert json.loads(text, parse_constant=refuse) == {
        "nan": None,
        "inside": [{"inf": None, "many": [1.5, None]}],
        "whole": 3,
        "truth": True,
        "tuple": [0.5, None, "text"],
        "checks": [{"name": "x", "value": None, "target": "<= 2", "unit": "px", "holds": False}],
    }
    assert plain(figures["whole"]).__class__ is int


@pytest.mark.parametrize(
    ("value", "direction", "target", "holds"),
    [
        (1.0, "<=", 1, True),
        (1.1, "<=", 1, False),
        (1.0, ">=", 1, True),
        (0.9, ">=", 1, False),
        (1, "==", 1, True),
        (2, "==", 1, False),
        (None, "<=", 1, False),
        (float("nan"), "<=", 1, False),
        (float("nan"), ">=", 1, False),
        (float("nan"), "==", 1, False),
        (np.float64(0.5), "<=", 1, True),
    ],
)
def test_checks(value, direction, target, holds):
    made = check("figure", value, direction, target, "unit")
    assert made.holds is holds
    assert all_hold([made]) is holds
    assert made.target == f"{direction} {target}"


def test_tables_take_any_text(capsys):
    console = Console(width=200)
    show_figures(console, "[/] title", {"path": "/a[/b]/c", "number": 0.123456789, "list": [1], "[x]": 3})
    show_checks(console, [check("[/y]", None, "<=", 3, "[px]"), check("z", True, "==", 1, "")])
    out = capsys.readouterr().out
    for text in ("[/] title", "/a[/b]/c", "0.123457", "[x]", "[/y]", "[px]", "none", "holds", "falls short"):
        assert text in out
    assert "list" not in out
