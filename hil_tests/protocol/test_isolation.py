"""The room stands alone: construct, the standard library, and the firmware's vocabulary, which is
enumerations and tables without code.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

from st_emulator import protocol
from st_emulator.firmware_model import modes, reasons
from st_emulator.protocol import Mode, Reason

ROOM = Path(protocol.__file__).parent
VOCABULARY = {"modes", "reasons", "causes", "parameter_table"}


@pytest.mark.parametrize(
    "path", sorted(ROOM.rglob("*.py")), ids=lambda path: path.relative_to(ROOM).as_posix()
)
def test_imports(path: Path) -> None:
    depth = len(path.relative_to(ROOM).parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [] if node.level else [node.module or ""]
            if node.level > depth:
                assert node.level == depth + 1, f"{path}: an import leaves the package"
                room, _, module = (node.module or "").partition(".")
                assert room == "firmware_model", f"{path}: an import leaves the room"
                named = {module.split(".")[0]} if module else {alias.name for alias in node.names}
                assert named <= VOCABULARY, f"{path}: {named}"
        else:
            continue
        for module in modules:
            top = module.split(".")[0]
            assert top == "construct" or top in sys.stdlib_module_names, f"{path}: {module}"
            assert top not in ("time", "os", "socket", "threading", "datetime"), f"{path}: {module}"


@pytest.mark.parametrize("name", sorted(VOCABULARY))
def test_the_vocabulary_imports_nothing_but_the_standard_library(name: str) -> None:
    tree = ast.parse((ROOM.parent / "firmware_model" / f"{name}.py").read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0
            assert (node.module or "").split(".")[0] in sys.stdlib_module_names
        elif isinstance(node, ast.Import):
            assert all(alias.name.split(".")[0] in sys.stdlib_module_names for alias in node.names)


def test_modes_and_reasons_are_the_firmwares() -> None:
    assert Mode is modes.Mode
    assert Reason is reasons.Reason
