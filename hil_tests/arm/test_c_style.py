"""One style for the C sources: what .clang-format says, by the clang-format of the package."""

from __future__ import annotations

import subprocess
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Beside this interpreter: another version that may be on the PATH breaks some lines otherwise.
CLANG_FORMAT = Path(sysconfig.get_path("scripts")) / "clang-format"
SOURCES = sorted(
    path
    for room in ("firmware_model", "protocol", "st_emulator", "hil_tests", "tools", "examples")
    for path in (ROOT / room).rglob("*.[ch]")
)


def complaints(path: Path) -> str:
    """What clang-format would change, one line for each place; empty for a file that is formatted."""
    line = [CLANG_FORMAT, "--dry-run", "-Werror", f"--style=file:{ROOT / '.clang-format'}", path]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (not done.stderr)
    return done.stderr


def test_every_c_file_is_formatted() -> None:
    assert len(SOURCES) > 40
    assert "".join(complaints(path) for path in SOURCES) == ""


@pytest.mark.parametrize(
    "text",
    [
        "int f(int a)\n{\n  return a;\n}\n",
        "int f(int a) {\n    return a;\n}\n",
        "int f(int* a)\n{\n    return *a;\n}\n",
    ],
)
def test_another_style_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "odd.c"
    path.write_text(text, encoding="utf-8")
    assert "code should be clang-formatted" in complaints(path)
    path.write_text("int f(int *a)\n{\n    return *a;\n}\n", encoding="utf-8")
    assert complaints(path) == ""
