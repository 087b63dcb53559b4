"""Tests of the pytest plugin: projects of a user's, run by a pytest of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import st_emulator

PACKAGE = Path(st_emulator.__file__).parents[1]
TIMEOUT_S = 300.0  # only bounds a hang
# As where the package is installed, whether this checkout is or not.
ENTRY_POINT = "[pytest11]\nst_emulator = st_emulator.pytest_plugin\n"


@dataclass
class Outcome:
    """What a pytest said, and its exit status."""

    status: int
    text: str

    @property
    def last(self) -> str:
        """The line of counts."""
        return self.text.strip().splitlines()[-1]


class Project:
    """A folder with a user's tests."""

    def __init__(self, folder: Path, runtime: Path) -> None:
        self.folder = folder
        self.runtime = runtime
        site = folder / "site"
        metadata = site / "st_emulator_entry-1.dist-info"
        metadata.mkdir(parents=True)
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: st-emulator-entry\nVersion: 1\n")
        (metadata / "entry_points.txt").write_text(ENTRY_POINT)
        self.environment = {
            name: value for name, value in os.environ.items() if not name.startswith("PYTEST")
        }
        self.environment |= {
            "PYTHONPATH": os.pathsep.join((str(PACKAGE), str(site))),
            "XDG_RUNTIME_DIR": str(runtime),
            "COLUMNS": "200",
        }
        (folder / "pytest.ini").write_text("[pytest]\naddopts = --import-mode=importlib\n")

    def write(self, name: str, text: str) -> Path:
        path = self.folder / name
        path.write_text(text)
        return path

    def command(self, *arguments: str) -> list[str]:
        temporary = ["--basetemp", str(self.folder / "tmp"), "-p", "no:cacheprovider"]
        return [sys.executable, "-m", "pytest", *temporary, "--rootdir", str(self.folder), *arguments]

    def run(self, *arguments: str, **environment: str) -> Outcome:
        run = subprocess.run(
            self.command(*arguments),
            cwd=self.folder,
            env=self.environment | environment,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            stdin=subprocess.DEVNULL,
        )
        return Outcome(run.returncode, run.stdout + run.stderr)

    def start(self, *arguments: str) -> subprocess.Popen[Any]:
        """The same, which goes on beside the test."""
        return subprocess.Popen(
            self.command(*arguments),
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
        )

    def left(self) -> list[str]:
        """Links and locks in the user's runtime folder, and processes that know this project's folder."""
        there = [str(path) for path in self.runtime.rglob("*") if path.is_symlink() or path.is_file()]
        marked = f"XDG_RUNTIME_DIR={self.runtime}".encode()
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if marked in (process / "environ").read_bytes().split(b"\0"):
                    there.append(f"process {process.name}: {(process / 'cmdline').read_bytes()!r}")
            except OSError:
                continue  # it has ended, or is not ours
        return there


@pytest.fixture
def project(tmp_path: Path) -> Project:
    folder, runtime = tmp_path / "project", tmp_path / "runtime"
    folder.mkdir()
    runtime.mkdir()
    return Project(folder, runtime)
