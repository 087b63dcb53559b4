"""What a user installs: the wheel's contents, and that no project's own `protocol` folder is disturbed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from hil_tests.architecture.source_tree import ROOT, sources

PROGRAM = """
import importlib.util, json
import protocol
import firmware_model
import st_emulator.protocol
import st_emulator.firmware_model.modes
from st_emulator.protocol import encode_telecommand
from st_emulator.units.profile import load_unit, unit_names
from st_emulator.device.calibration import processor_profile
assert protocol.WHO == "the OBC project's own", protocol
assert firmware_model.WHO == "the OBC project's own", firmware_model
assert protocol.__name__ == "protocol" and st_emulator.protocol.__name__ == "st_emulator.protocol"
assert protocol is not st_emulator.protocol
for name in unit_names():
    processor_profile(load_unit(name))
print(json.dumps({
    "units": unit_names(),
    "ping": encode_telecommand("ping", apid=1, sequence_count=0).hex(),
    "where": st_emulator.__file__,
    "at_top": [name for name in ("tools", "hil_tests") if importlib.util.find_spec(name)],
}))
"""
BARE = """
import importlib.util
import st_emulator.protocol
names = ("protocol", "firmware_model", "tools", "hil_tests")
print([name for name in names if importlib.util.find_spec(name)])
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy of the sources, without a package index."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("st_emulator", "protocol", "firmware_model", "hil_tests", "tools"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(folder),
        str(source),
    ]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stdout + run.stderr
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_holds_everything_under_one_name(wheel):
    names = {name for name in zipfile.ZipFile(wheel).namelist() if not name.endswith("/")}
    info = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    assert {name.split("/")[0] for name in names - info} == {"st_emulator"}
    expected = {
        f"st_emulator/{source.path.removeprefix('st_emulator/')}"
        for source in sources()
        if source.module.startswith("st_emulator")
    }
    for pattern in (
        "st_emulator/units/*.toml",
        "st_emulator/budget/*.jinja",
        "firmware_model/cycle_costs/*.json",
        "*/py.typed",
    ):
        found = [path.relative_to(ROOT).as_posix() for path in ROOT.glob(pattern)]
        assert found
        expected |= {f"st_emulator/{path.removeprefix('st_emulator/')}" for path in found}
    assert names - info == expected
    assert any(name.endswith("licenses/LICENSE") for name in info)
    entry_points = next(name for name in info if name.endswith("entry_points.txt"))
    said = zipfile.ZipFile(wheel).read(entry_points)
    assert b"st-emulator = st_emulator.cli:main" in said
    assert b"[pytest11]\nst_emulator = st_emulator.pytest_plugin" in said


def clean_environment(**more: str) -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | more


def python(folder: Path, program: str, **environment: str) -> str:
    script = folder / "script.py"
    script.write_text(program)
    run = subprocess.run(
        [sys.executable, str(script)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        env=clean_environment(**environment),
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """An OBC project with folders of the same names as two of our rooms."""
    folder = tmp_path / "obc_project"
    for name in ("protocol", "firmware_model"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text('WHO = "the OBC project\'s own"\n')
    return folder


@pytest.fixture
def unpacked(wheel: Path, tmp_path: Path) -> Path:
    target = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(target)
    return target


def test_a_project_with_a_protocol_of_its_own_and_the_wheel(project, unpacked):
    out = python(project, PROGRAM, PYTHONPATH=str(unpacked))
    assert str(unpacked / "st_emulator") in out  # it was the wheel's
    assert '"at_top": []' in out
    # The other order too: the installed packages stand before the project's folder on the path.
    script = f"import sys; sys.path.insert(0, {str(unpacked)!r})\n" + PROGRAM
    assert '"at_top": []' in python(project, script)


def test_a_project_with_a_protocol_of_its_own_and_the_checkout_installed_for_editing(project):
    out = python(project, PROGRAM)
    assert '"at_top": []' in out


def test_only_st_emulator_is_there(tmp_path, unpacked):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    assert python(folder, BARE).strip() == "[]"
    assert python(folder, BARE, PYTHONPATH=str(unpacked)).strip() == "[]"


def test_the_wheels_command_line_runs(unpacked, tmp_path):
    run = subprocess.run(
        [sys.executable, "-m", "st_emulator", "units"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        env=clean_environment(PYTHONPATH=str(unpacked)),
    )
    assert (run.returncode, run.stderr) == (0, "")
    assert "roja1" in run.stdout
