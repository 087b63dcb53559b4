"""The project's sources and what each imports, read with ast; nothing is imported or run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
OURS = ("st_emulator", "protocol", "firmware_model", "hil_tests", "tools")
GENERATED = {"__pycache__", "build", "dist", "demo-out", ".git", ".venv"}


@dataclass(frozen=True)
class Source:
    """One Python file under the name that it is imported by."""

    path: str  # from the root, with /
    module: str
    tree: ast.Module
    lines: int

    @property
    def is_package(self) -> bool:
        return self.path.endswith("/__init__.py")

    def imports(self) -> Iterator[str]:
        """Full names of what is imported; of `from x import y` both x and x.y, as y may be a module."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = self._base(node)
                yield base
                yield from (f"{base}.{alias.name}" for alias in node.names)

    def _base(self, node: ast.ImportFrom) -> str:
        if not node.level:
            return node.module or ""
        parts = self.module.split(".")
        parts = parts[: len(parts) - node.level + self.is_package]
        return ".".join([*parts, *(node.module or "").split(".")]).rstrip(".")


def module_of(path: Path) -> str:
    """protocol/pus/packets.py is st_emulator.protocol.pus.packets, as it is installed."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[-1] == "__init__":
        parts.pop()
    if parts[0] in ("protocol", "firmware_model"):
        parts.insert(0, "st_emulator")
    return ".".join(parts)


@cache
def sources() -> tuple[Source, ...]:
    """Every Python file of ours, the symbolic links' targets once."""
    found = []
    for folder in OURS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            inside = path.relative_to(ROOT)
            linked = inside.parts[:2] in (("st_emulator", "protocol"), ("st_emulator", "firmware_model"))
            if linked or GENERATED & set(inside.parts):
                continue
            text = path.read_text(encoding="utf-8")
            found.append(Source(inside.as_posix(), module_of(path), ast.parse(text), text.count("\n")))
    return tuple(found)


def under(*modules: str) -> list[Source]:
    """The sources of modules or packages, those below them included; there must be some."""
    found = [source for source in sources() if source.module.startswith(tuple(f"{m}." for m in modules))]
    found += [source for source in sources() if source.module in modules]
    assert found, modules
    return found


def is_in(name: str, *modules: str) -> bool:
    return any(name == module or name.startswith(module + ".") for module in modules)


def text_files() -> Iterator[tuple[str, str]]:
    """(path, text) of every text file that belongs to the project."""
    for path in sorted(ROOT.iterdir()):
        if (
            path.name in GENERATED
            or path.name.endswith(("_cache", ".egg-info"))
            or path.name == ".hypothesis"
        ):
            continue
        files = [path] if path.is_file() else sorted(path.rglob("*"))
        for file in files:
            inside = file.relative_to(ROOT)
            if not file.is_file() or GENERATED & set(inside.parts):
                continue
            try:
                yield inside.as_posix(), file.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue  # a picture
