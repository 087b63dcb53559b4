"""The part "identification" of tools/bench: all algorithms on the same scenes; which peers are absent."""

import json
import subprocess
import sys
from importlib.util import find_spec

from hil_tests.architecture.source_tree import ROOT
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS

SCENES = 20


def test_every_algorithm_is_measured_and_none_is_wrong() -> None:
    script = ROOT / "tools" / "benchmarks" / "identification.py"
    command = [sys.executable, str(script), "--scenes", str(SCENES), "--seed", "3", "--seconds", "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["scene"] for line in lines[:-1]] == [SCENES, SCENES]
    figures = lines[-1]["figures"]
    assert figures["seed"] == 3
    assert figures["catalogue"].startswith("Hipparcos, Hp < 5.5, 2")
    peers = {"tetra3rs": "tetra3rs", "cedar-solve": "tetra3"}
    present = {name for name, module in peers.items() if find_spec(module)}
    assert {name for name in peers if "pip install" in figures["peers"][name].get("absent", "")} == (
        set(peers) - present
    )
    for solvers in figures["cases"].values():
        assert set(solvers) == set(ALGORITHMS) | present
        for name, solver in solvers.items():
            assert 0 < solver["median_ms"] <= solver["p95_ms"]
            assert solver["right"] + solver["wrong"] + solver["not_solved"] == solver["scenes"]
            assert name not in ALGORITHMS or solver["wrong"] == 0
            assert ("median_to_tetra3rs" in solver) == ("tetra3rs" in present)
    for name in ALGORITHMS:
        clear = figures["cases"]["no_false_stars"][name]
        assert clear["right"] == clear["scenes"] == SCENES
        assert clear["operations_median"] > 100
