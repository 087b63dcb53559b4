"""Dialects of users that are wrong: one line that names file, key and what is allowed; exit status 2."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil_tests.architecture.source_tree import ROOT
from hil_tests.dialects.command_line import modules_apart, run_in
from st_emulator.dialects.registry import SHIPPED, dialect_named, settings_of
from st_emulator.errors import ConfigurationError
from st_emulator.units.profile import load_unit

TEMPLATE = ROOT / "examples/my_dialect"
CHOSEN = 'dialect = "my_dialect.definition:DIALECT"'


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """The template as a user copies it."""
    return Path(shutil.copytree(TEMPLATE, tmp_path / "project", ignore=shutil.ignore_patterns("__pycache__")))


def refused(project: Path, *says: str, link: str = "none", more: tuple[str, ...] = ()) -> str:
    """`st-emulator run ./my_unit.toml` in the project: its only line."""
    ended = run_in(project, "run", "./my_unit.toml", "--link", link, *more)
    assert (ended.status, ended.out) == (2, ""), ended.err
    (line,) = ended.err.splitlines()
    for text in says:
        assert text in line, f"{text!r} is not in {line!r}"
    return line


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


NAMES = {
    "no dialect": ("sagita", ("found 'sagita'", *(item.name for item in SHIPPED), "module:NAME")),
    "no name": ("my_dialect.definition:", ("module:NAME",)),
    "no module": (":DIALECT", ("module:NAME",)),
    "a path": ("my_dialect/definition.py:DIALECT", ("module:NAME",)),
    "not there": ("my_dialekt.definition:DIALECT", ("no module my_dialekt", "PYTHONPATH")),
    "not in the package": (
        "my_dialect.definitions:DIALECT",
        (
            "no module definitions in package my_dialect",
            "allowed are definition, dialect, exchange, messages",
        ),
    ),
    "below a module": ("my_dialect.messages.x:DIALECT", ("no package", "my_dialect.messages:NAME")),
    "no such object": ("my_dialect.definition:DIALEKT", ("DIALEKT", "is not there", "there is DIALECT")),
    "another object": (
        "my_dialect.messages:COMMANDS",
        ("COMMANDS", "no DialectDefinition but a tuple", "messages.py", "there is none in it"),
    ),
    "taken": ("json:DIALECT", ("DIALECT in module json", "is not there")),
}


@pytest.mark.parametrize("name", NAMES)
def test_name(name, project):
    dialect, says = NAMES[name]
    (project / "my_unit.toml").write_text(
        (project / "my_unit.toml").read_text().replace(CHOSEN, f'dialect = "{dialect}"')
    )
    refused(project, "st-emulator: my_unit.toml: wire.dialect: ", *says)


MODULES = {
    "syntax": ("x = (\n", ("own.py, line 1: SyntaxError: '(' was never closed",)),
    "name": ("x = 1\ny = z\n", ("own.py, line 2: NameError: name 'z' is not defined",)),
    "exit": ("raise SystemExit(0)\n", ("own.py, line 1: SystemExit",)),
    "in a library": ("import json\njson.loads('{')\n", ("own.py, line 2: JSONDecodeError",)),
    "no such library": (
        "import no_such_library\n",
        ("own.py, line 1: ModuleNotFoundError", "from .messages import", "PYTHONPATH"),
    ),
    "an argument is missing": (
        "from st_emulator.dialects.dialect import DialectDefinition\nX = DialectDefinition(name='x')\n",
        ("own.py, line 2: TypeError", "missing", "title"),
    ),
    "the name of a shipped one": (
        "from st_emulator.dialects.pus.definition import PUS as X\n",
        ("calls itself 'pus'", "any other name"),
    ),
}


@pytest.mark.parametrize("name", MODULES)
def test_module(name, project):
    text, says = MODULES[name]
    (project / "own.py").write_text(text)
    change(project / "my_unit.toml", CHOSEN, 'dialect = "own:X"')
    refused(project, "st-emulator: my_unit.toml: wire.dialect: ", "own", *says)


def test_a_package_without_init(project):
    (project / "my_dialect/__init__.py").unlink()
    refused(project, "wire.dialect: there is no module my_dialect: ", "project/my_dialect has no __init__.py")


SETTINGS = {
    "unknown": ("adress = 7", ("dialects.my_dialect: adress: is not a known key", "address, attitude_every")),
    "out of range": (
        "address = 255",
        ("dialects.my_dialect: address: found 255; allowed is a whole number from 1 to 254",),
    ),
    "of another kind": ("address = 'x'", ("dialects.my_dialect: address: found 'x'", "from 1 to 254")),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_setting(name, project):
    line, says = SETTINGS[name]
    change(project / "my_unit.toml", "address = 7", line)
    refused(project, *says)


def test_settings_of_a_dialect_that_nobody_speaks(project):
    change(project / "my_unit.toml", "[dialects.my_dialect]", "[dialects.mydialect]")
    refused(project, "dialects.mydialect: is not the name", "allowed are my_dialect, pus")
    change(project / "my_unit.toml", "[dialects.mydialect]", "[dialects.my_dialect]\n[dialects.other]")
    change(project / "my_unit.toml", "address = 7", "")
    change(project / "my_unit.toml", "attitude_every = 1", "")
    unit = load_unit(str(project / "my_unit.toml"))
    shipped = unit.model_copy(update={"wire": unit.wire.model_copy(update={"dialect": "pus"})})
    with modules_apart():
        assert settings_of(unit)  # its own table is there: another one belongs to another dialect
        assert settings_of(shipped) is not None  # settings of a dialect that is not spoken now may stay


def test_a_serial_dialect_on_a_bus(project):
    refused(
        project,
        "wire.dialect: my_dialect has no CAN bus",
        "allowed is a link that is a serial line (pty, serial:DEV, none)",
        link="can:virtual/x",
    )


def test_a_bus_dialect_on_a_serial_line(project):
    (project / "own.py").write_text(
        "import dataclasses\nfrom st_emulator.dialects.pus.definition import PUS\n"
        "X = dataclasses.replace(PUS, name='bus', on_serial=None)\n"
    )
    change(project / "my_unit.toml", CHOSEN, 'dialect = "own:X"')
    refused(
        project,
        "st-emulator: my_unit.toml: wire.dialect: bus has no serial line",
        "allowed is a link that is a CAN bus (can:INTERFACE/CHANNEL)",
        link="pty",
    )


def test_an_option_that_is_wrong(project):
    change(project / "my_unit.toml", CHOSEN, "")
    refused(
        project,
        "st-emulator: --dialect: there is no module definitions in package my_dialect",
        more=("--dialect", "my_dialect.definitions:DIALECT"),
    )
    refused(project, "st-emulator: --dialect: found 'sagita'; allowed are pus", more=("--dialect", "sagita"))


def test_a_scenario_of_other_telecommands(project):
    change(project / "my_scenario.toml", 'name = "find_attitude"', 'name = "acquire"')
    refused(
        project,
        "st-emulator: my_scenario.toml: telecommands.0: telecommand: name = 'acquire'; allowed: get_status, ",
        more=("--scenario", "my_scenario.toml"),
    )


def test_in_a_process_of_its_own(project):
    """As a user has it, from another folder."""
    change(project / "my_unit.toml", "address = 7", "address = 0")
    ended = subprocess.run(
        [sys.executable, "-m", "st_emulator", "run", str(project / "my_unit.toml")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == (
        f"st-emulator: {project}/my_unit.toml: dialects.my_dialect: address: found 0; allowed is a whole "
        "number from 1 to 254\n"
    )


def own(folder: Path, name: str, title: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.py").write_text(
        f"import dataclasses\nfrom st_emulator.dialects.pus.definition import PUS\n"
        f"X = dataclasses.replace(PUS, name={name!r}, title={title!r})\n"
    )
    return folder


def test_where_a_module_is_looked_for(tmp_path, monkeypatch):
    """Beside the unit file, then on the Python path, then in the current folder."""
    beside, path, current = (tmp_path / name for name in ("beside", "path", "current"))
    monkeypatch.syspath_prepend(str(path))
    monkeypatch.chdir(own(current, "found_third", "current"))
    for name in ("found_first", "found_second"):
        own(current, name, "current")
        own(path, name, "path")
    own(beside, "found_first", "beside")
    before = list(sys.path)
    titles = [
        dialect_named(f"{name}:X", beside).title for name in ("found_first", "found_second", "found_third")
    ]
    assert titles == ["beside", "path", "current"]
    assert sys.path == before


def test_a_file_beside_takes_no_other_modules_place(tmp_path):
    own(tmp_path, "json", "no")
    with pytest.raises(ConfigurationError, match=r"module json in .* another of that name is \(.*json"):
        dialect_named("json:X", tmp_path)
    assert sys.modules["json"] is json


def test_two_of_one_name_are_not_taken_for_one_another(tmp_path):
    first, second = (own(tmp_path / name, "of_one_name", name) for name in ("first", "second"))
    assert dialect_named("of_one_name:X", first).title == "first"
    assert dialect_named("of_one_name:X", first).title == "first"
    with pytest.raises(ConfigurationError, match=r"of_one_name in .*second.*first.*a name of its own"):
        dialect_named("of_one_name:X", second)


def test_a_module_that_was_mended_is_tried_again(tmp_path):
    (tmp_path / "mended.py").write_text("x = y\n")
    with pytest.raises(ConfigurationError, match="NameError"):
        dialect_named("mended:X", tmp_path)
    own(tmp_path, "mended", "mended now")
    assert dialect_named("mended:X", tmp_path).title == "mended now"
