"""What a running unit loads: no plotting, no astronomy package, no test tools. They cost memory and start."""

import json
import subprocess
import sys

import pytest

# scipy is there for the tests only. It is hidden: numba looks for it by itself and does without.
PROGRAM = """
import json, sys
sys.modules["scipy"] = None
import st_emulator.commands.running
from st_emulator.bench.emulator import Emulator
from st_emulator.units.profile import load_unit
emulator = Emulator(load_unit("roja1"))
emulator.advance(1_000_000_000)
print(json.dumps({"now_ns": emulator.now_ns, "loaded": sorted(sys.modules)}))
"""


@pytest.fixture(scope="module")
def loaded():
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout)
    assert said["now_ns"] == 1_000_000_000
    return set(said["loaded"])


def test_the_unit_was_loaded_and_runs_without_scipy(loaded):
    assert {
        "st_emulator.device.star_tracker",
        "st_emulator.world.scene",
        "st_emulator.firmware_model.firmware",
    } <= loaded
    assert not [name for name in loaded if name.startswith("scipy.")]


@pytest.mark.parametrize("package", ["matplotlib", "astropy", "pytest", "_pytest", "hypothesis", "typer"])
def test_a_running_unit_does_not_load(loaded, package):
    assert not [name for name in loaded if name == package or name.startswith(f"{package}.")]


@pytest.mark.parametrize("room", ["obc", "campaigns", "demo", "pictures", "cli", "testing", "pytest_plugin"])
def test_a_running_unit_does_not_load_the_room(loaded, room):
    own = f"st_emulator.{room}"
    assert not [name for name in loaded if name == own or name.startswith(f"{own}.")]
