"""`st-emulator` in a user's folder, in this process: modules of the folder are loaded anew and forgotten."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from st_emulator import cli
from st_emulator.dialects import registry

NAMES = ("my_dialect", "own")


@dataclass(frozen=True)
class Outcome:
    """What a command left."""

    status: int
    out: str
    err: str


def _taken_out() -> dict[str, object]:
    registry._own.cache_clear()
    return {name: sys.modules.pop(name) for name in list(sys.modules) if name.split(".")[0] in NAMES}


@contextlib.contextmanager
def modules_apart() -> Iterator[None]:
    """In the block no module of a user's is loaded; afterwards those that were loaded before it are."""
    before = _taken_out()
    try:
        yield
    finally:
        _taken_out()
        sys.modules.update(before)


def run_in(folder: Path, *arguments: str) -> Outcome:
    """The command with these arguments, in a folder."""
    out, err = io.StringIO(), io.StringIO()
    status = 0
    with (
        modules_apart(),
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.object(sys, "argv", ["st-emulator", *arguments]),
    ):
        try:
            cli.main()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
    return Outcome(status, out.getvalue(), err.getvalue())
