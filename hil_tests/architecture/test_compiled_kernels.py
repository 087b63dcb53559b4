"""Where compiled kernels are kept: a folder that every process of the program finds, and no trace of it in
an import."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hil_tests.architecture.source_tree import ROOT, Source, under
from st_emulator import compiled_kernels

FOLDER = (
    "from st_emulator.compiled_kernels import keep_compiled_kernels; print(keep_compiled_kernels(), end='')"
)
# From here on a process says what it compiles, whichever kernel of whoever's it is.
LISTEN = """
import json, sys
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, happening):
        kernel = happening.data["dispatcher"]
        compiled.append((kernel.py_func.__module__, kernel.py_func.__name__, kernel.stats.cache_path))
    def on_end(self, happening):
        pass
event.register("numba:compile", Listener())
"""


def run(program: str, *arguments: str, here: Path = ROOT, **environment: str) -> str:
    """What a fresh process prints that finds modules in a folder, with no folder for numba but one in
    ``environment``.
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=kept | environment,
        cwd=here,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def cache_folder(**environment: str) -> Path:
    return Path(run(FOLDER, **environment))


def kernels_of(source: Source) -> list[ast.Call]:
    """The calls of njit in a file."""
    calls = [node for node in ast.walk(source.tree) if isinstance(node, ast.Call)]
    return [call for call in calls if ast.unparse(call.func).split(".")[-1] in ("jit", "njit")]


# -- the folder


def test_in_the_users_cache_folder(tmp_path: Path) -> None:
    folder = cache_folder(XDG_CACHE_HOME=str(tmp_path))
    assert folder.parent == tmp_path / "st-emulator"
    assert folder.name.startswith("kernels-")


def test_where_the_user_says(tmp_path: Path) -> None:
    assert cache_folder(NUMBA_CACHE_DIR=str(tmp_path / "own")) == tmp_path / "own"


def test_an_empty_variable_says_nothing(tmp_path: Path) -> None:
    folder = cache_folder(XDG_CACHE_HOME=str(tmp_path), NUMBA_CACHE_DIR="")
    assert folder.parent == tmp_path / "st-emulator"


def test_in_a_folder_of_the_users_own_where_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    folder = cache_folder(XDG_CACHE_HOME=str(tmp_path / "file"), TMPDIR=str(tmp_path))
    own = tmp_path / f"st-emulator-cache-{os.getuid()}"
    assert folder.parent.parent == own
    assert own.stat().st_mode & 0o777 == 0o700


def test_never_where_others_can_write(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for number in ("", "-1", "-2"):
        taken = tmp_path / f"st-emulator-cache-{os.getuid()}{number}"
        taken.mkdir()
        taken.chmod(0o777)
    (tmp_path / f"st-emulator-cache-{os.getuid()}-0").symlink_to(tmp_path)
    surroundings = {"XDG_CACHE_HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path)}
    folder = cache_folder(**surroundings)
    own = folder.parent.parent
    assert own.parent == tmp_path
    assert own.stat().st_mode & 0o777 == 0o700
    assert cache_folder(**surroundings) == folder, "another process compiles all anew"


# -- imports

WATCH = """
import json, os, sys
written, opened = [], []
def watch(event, arguments):
    if event == "open":
        path, _, flags = arguments
        opened.append(str(path))
        if flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            written.append(str(path))
    elif event in ("os.mkdir", "os.rename", "os.remove", "os.link", "os.symlink", "subprocess.Popen"):
        written.append(f"{event} {arguments}")
sys.addaudithook(watch)
before = dict(os.environ)
__import__(sys.argv[1])
print(json.dumps({
    "environment": before == dict(os.environ),
    "written": written,
    "opened": opened,
    "numba": "numba" in sys.modules,
    "names": sorted(vars(sys.modules["st_emulator"])) if "st_emulator" in sys.modules else [],
}))
"""


def imported(module: str, here: Path = ROOT, **environment: str) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(
        run(WATCH, module, here=here, PYTHONDONTWRITEBYTECODE="1", **environment)
    )
    return said


@pytest.mark.parametrize(
    "module",
    [
        "",
        ".protocol",
        ".firmware_model.firmware",
        ".world.scene",
        ".bench.emulator",
        ".compiled_kernels",
        ".cli",
    ],
)
def test_an_import_writes_nothing_and_sets_nothing(module: str, tmp_path: Path) -> None:
    said = imported(f"st_emulator{module}", XDG_CACHE_HOME=str(tmp_path))
    assert said["environment"]
    assert said["written"] == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("module", ["", ".protocol", ".compiled_kernels"])
def test_who_imports_no_kernel_waits_for_none(module: str) -> None:
    said = imported(f"st_emulator{module}")
    assert not said["numba"]
    with_kernels = {ROOT / source.path for source in under("st_emulator") if kernels_of(source)}
    assert with_kernels & {Path(path).resolve() for path in said["opened"]} == set()


def test_the_package_has_its_version_alone() -> None:
    own = [name for name in imported("st_emulator")["names"] if not name.startswith("__")]
    assert own == []


def test_an_import_that_writes_would_be_seen(tmp_path: Path) -> None:
    """Numba makes the folder when a function is decorated: so the kernels' decorators say nothing of it."""
    (tmp_path / "kernel.py").write_text(
        "import os\nfrom numba import njit\nos.environ['SET'] = ''\n"
        "@njit(cache=True)\ndef kernel():\n    return 1\n"
    )
    said = imported("kernel", tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "numba"))
    assert not said["environment"]
    assert said["numba"]
    assert any("numba" in line for line in said["written"])


# -- what is kept, on a program of two kernels in two files, one calling the other

CALLEE = "from numba import njit\n\n\n@njit(nogil=True)\ndef callee():\n    return {value}\n"
CALLER = (
    "from numba import njit\n\nfrom ..firmware_model.callee import callee\n\n\n"
    "@njit(nogil=True)\ndef caller():\n    return 10 * callee()\n"
)
CALL = LISTEN + (
    "from numba.core import config\n"
    "config.CACHE_DIR = 'of others'\n"
    "from st_emulator.compiled_kernels import keep_compiled_kernels\n"
    "import st_emulator.firmware_model.callee\n"
    "keep_compiled_kernels()\n"
    "from st_emulator.world.caller import caller\n"
    "folder = keep_compiled_kernels()\n"
    "assert config.CACHE_DIR == 'of others'\n"
    "value = caller()\n"
    "hits = sum(caller.stats.cache_hits.values())\n"
    "print(json.dumps({'value': value, 'compiled': compiled, 'hits': hits, 'folder': str(folder)}))\n"
)


@pytest.fixture
def small_program(tmp_path: Path) -> Path:
    """A package of that name with our way of keeping kernels and two kernels of its own."""
    root = tmp_path / "program"
    for room, name, text in (
        ("firmware_model", "callee", CALLEE.format(value=1)),
        ("world", "caller", CALLER),
    ):
        (root / "st_emulator" / room).mkdir(parents=True)
        (root / "st_emulator" / room / "__init__.py").touch()
        (root / "st_emulator" / room / f"{name}.py").write_text(text)
    (root / "st_emulator" / "__init__.py").touch()
    shutil.copy(str(compiled_kernels.__file__), root / "st_emulator")
    return root


def call(root: Path, cache: Path) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(run(CALL, here=root, XDG_CACHE_HOME=str(cache)))
    return said


def test_a_second_process_compiles_nothing(small_program: Path, tmp_path: Path) -> None:
    first, second = (call(small_program, tmp_path / "cache") for _ in range(2))
    assert first["value"] == second["value"] == 10
    assert first["folder"] == second["folder"]
    assert Path(first["folder"]).is_relative_to(tmp_path / "cache")
    assert [name for _, name, _ in first["compiled"]] == ["caller", "callee"]
    for _, _, path in first["compiled"]:
        assert Path(path).is_relative_to(first["folder"])
    assert (first["hits"], second["hits"]) == (0, 1)
    assert second["compiled"] == []


def test_an_edited_callee_is_run_as_it_is_now(small_program: Path, tmp_path: Path) -> None:
    before = call(small_program, tmp_path / "cache")
    (small_program / "st_emulator/firmware_model/callee.py").write_text(CALLEE.format(value=2))
    after = call(small_program, tmp_path / "cache")
    assert (before["value"], after["value"]) == (10, 20)
    assert before["folder"] != after["folder"]


@pytest.mark.parametrize("room", compiled_kernels.ROOMS_WITH_KERNELS)
def test_the_digest_is_of_our_own_sources(room: str, tmp_path: Path) -> None:
    """Also where a room is a link; an edit of any file of a room changes it."""
    digest = compiled_kernels.sources_digest(ROOT / "st_emulator")
    for name in compiled_kernels.ROOMS_WITH_KERNELS:
        shutil.copytree(ROOT / "st_emulator" / name, tmp_path / name)
    assert compiled_kernels.sources_digest(tmp_path) == digest
    for source in (tmp_path / room).rglob("*.py"):
        text = source.read_text()
        source.write_text(text + "#")
        assert compiled_kernels.sources_digest(tmp_path) != digest, source
        source.write_text(text)


def test_every_kernel_is_in_a_room_that_is_searched_and_says_nothing_itself() -> None:
    """One elsewhere would be compiled anew by every process."""
    rooms = under(*(f"st_emulator.{room}" for room in compiled_kernels.ROOMS_WITH_KERNELS))
    assert [
        source.path for source in under("st_emulator") if source not in rooms and kernels_of(source)
    ] == []
    kernels = [kernel for source in rooms for kernel in kernels_of(source)]
    assert len(kernels) > 50
    assert [
        ast.unparse(kernel) for kernel in kernels if "cache" in {key.arg for key in kernel.keywords}
    ] == []


# -- who runs kernels has them kept

UNIT = """
from st_emulator.bench.emulator import Emulator
from st_emulator.units.profile import load_unit
from st_emulator.bench.scenario import Scenario, ScenarioTelecommand
acquire = ScenarioTelecommand(at_s=0.6, name="function", fields={"function_id": 2, "arguments": {}})
frames = []
emulator = Emulator(load_unit("roja1"), Scenario(telecommands=[acquire]), on_completed=frames.append)
emulator.advance(3_000_000_000)
assert len(frames) > 5
"""
CONFIGURATION = """
from st_emulator.device.calibration import firmware_configuration
from st_emulator.device.parameters import default_parameters
from st_emulator.units.profile import load_unit
firmware_configuration(load_unit("roja1"), default_parameters(load_unit("roja1")))
"""
CAMPAIGN = """
from functools import partial
from st_emulator.campaigns.batches import Batch, run_batch
from st_emulator.campaigns.single_stars import measure
from st_emulator.units.profile import load_unit
outcome = run_batch(Batch(partial(measure, load_unit("roja1"), 1, 1, True), (0,)))
assert outcome.items[0][0] == "", outcome
"""
CATALOGUE = """
from st_emulator.campaigns.catalogue_counts import pairs_under
from st_emulator.world.stars import star_field
assert pairs_under(star_field(1991.25, 4.0), 3.0, 20.0)[1] > 0
"""
IDENTIFICATION = """
from st_emulator.campaigns.star_scenes import scene_tables
assert len(scene_tables(3.0, 20.0).pairs.cos_angle)
"""
BUDGET = """
from st_emulator.budget.scenes import frames_of
from st_emulator.units.profile import load_unit
assert len([inputs.process() for inputs in frames_of(load_unit("roja1"), seed=1)]) == 3
"""
CALIBRATION = """
from tools.calibration.frames import FIT, records_of, sequences
assert list(records_of(sequences(1, FIT)[0]))
"""
SAY = """
from st_emulator.compiled_kernels import imported_kernels, keep_compiled_kernels
ran = [kernel for kernel in imported_kernels() if kernel.signatures]
print(json.dumps({
    "compiled": compiled,
    "ran": len(ran),
    "not kept": [kernel.py_func.__name__ for kernel in ran if kernel.stats.cache_path is None],
    "hits": sum(sum(kernel.stats.cache_hits.values()) for kernel in ran),
    "misses": sum(sum(kernel.stats.cache_misses.values()) for kernel in ran),
    "folder": str(keep_compiled_kernels()),
}))
"""


def ran(program: str, **environment: str) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(run(LISTEN + program + SAY, **environment))
    return said


@pytest.mark.parametrize(
    "program",
    [UNIT, CONFIGURATION, CAMPAIGN, CATALOGUE, IDENTIFICATION, BUDGET, CALIBRATION],
    ids=["unit", "configuration", "campaign", "catalogue", "identification", "budget", "calibration"],
)
def test_no_kernel_is_compiled_for_one_process_alone(program: str) -> None:
    said = ran(program)
    assert said["ran"] > 0
    assert said["not kept"] == []
    ours = [name for module, name, path in said["compiled"] if "st_emulator" in module and path is None]
    assert ours == []


@pytest.mark.slow
def test_after_the_warm_up_a_unit_compiles_nothing(tmp_path: Path) -> None:
    """Into an empty folder, as the first start of all."""
    warm_up = (
        "from st_emulator.units.profile import load_unit; from st_emulator.commands.warm_up import warm_up\n"
    )
    first = ran(warm_up + "warm_up(load_unit('roja1'))", NUMBA_CACHE_DIR=str(tmp_path))
    assert first["misses"] > 20
    assert (tmp_path / "warmed-up").exists()
    unit = ran(UNIT, NUMBA_CACHE_DIR=str(tmp_path))
    assert unit["folder"] == str(tmp_path)
    assert unit["compiled"] == []
    assert unit["misses"] == 0
    assert unit["hits"] == unit["ran"] > 20
