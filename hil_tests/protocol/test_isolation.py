"""The room stands alone: construct and the standard library; what it shares with the firmware agrees."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

from st_emulator import protocol
from st_emulator.firmware_model import modes, reasons
from st_emulator.protocol import Mode, Reason

ROOM = Path(protocol.__file__).parent


@pytest.mark.parametrize(
    "path", sorted(ROOM.rglob("*.py")), ids=lambda path: path.relative_to(ROOM).as_posix()
)
def test_imports(path: Path) -> None:
    depth = len(path.relative_to(ROOM).parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level <= depth, f"{path}: an import leaves the room"
            modules = [] if node.level else [node.module or ""]
        else:
            continue
        for module in modules:
            top = module.split(".")[0]
            assert top == "construct" or top in sys.stdlib_module_names, f"{path}: {module}"
            assert top not in ("time", "os", "socket", "threading", "datetime"), f"{path}: {module}"


def test_modes_and_reasons_are_those_of_the_firmware_number_by_number() -> None:
    assert {member.name: int(member) for member in Mode} == {
        member.name: int(member) for member in modes.Mode
    }
    assert {member.name: int(member) for member in Reason} == {
        member.name: int(member) for member in reasons.Reason
    }
