"""`st-emulator faults`, `[[faults]]` of a scenario, and the guide's examples."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import parse_scenario
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.listing import SEAMS, example, own_settings
from st_emulator.units.profile import load_unit
from st_emulator.wire.can.wiring import CanWiring

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "faults_guide.md"


def test_the_list_names_every_fault(command: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    outcome = command("faults")
    assert (outcome.status, outcome.err) == (0, "")
    for name in FAULTS:
        assert f"\u2502 {name} " in outcome.out, name


def test_as_json(command: Any) -> None:
    found = json.loads(command("faults", "--json", "-").out)
    assert [one["kind"] for one in found["faults"]] == list(FAULTS)
    assert {one["seam"] for one in found["faults"]} <= set(SEAMS)
    for one in found["faults"]:
        for key in ("what", "obc_sees", "afterwards"):
            assert one[key].endswith("."), (one["kind"], key)
        assert set(one["wires"]) <= {"serial", "can"}
    of_power = json.loads(command("faults", "--seam", "power", "--json", "-").out)
    assert of_power["faults"] == [one for one in found["faults"] if one["seam"] == "power"]
    (drift,) = json.loads(command("faults", "clock.drift", "--json", "-").out)["faults"]
    assert drift["settings"] == [
        {
            "name": "ppm",
            "allowed": "a number from -100000 to 100000",
            "default": 100.0,
            "required": False,
            "meaning": "parts per million; below 0 it runs too slowly",
        }
    ]
    names = [one["name"] for one in found["settings_of_all"]]
    assert names == ["start_s", "end_s", "duration_s", "probability", "seed"]


def test_one_whole(command: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    outcome = command("faults", "memory.bit_upset")
    for words in (
        "What the OBC must see",
        "[[faults]]",
        'kind = "memory.bit_upset"',
        "0 to 7",
        "must be given",
    ):
        assert words in outcome.out


def test_what_is_refused(refused: Any) -> None:
    refused("faults", "memory.gone", says=("KIND: found 'memory.gone'; allowed are ", "memory.bit_upset"))
    refused("faults", "--seam", "roof", says=("--seam: found 'roof'; allowed are line, bus, telemetry",))
    refused(
        "faults", "clock.drift", "--seam", "power", says=("KIND: found 'clock.drift'; allowed are power.",)
    )


@pytest.mark.parametrize("name", FAULTS)
def test_an_example_can_be_run(name: str) -> None:
    kind = FAULTS[name]
    text = example(kind)
    with_defaults = re.sub(r"^# (?!\w+ = \.\.\. #)", "", text, flags=re.MULTILINE)
    bare, whole = (parse_scenario(one, "example").faults for one in (text, with_defaults))
    assert bare == whole, "the defaults are those that hold"
    assert bare[0].kind == name
    for setting in own_settings(kind):
        assert f"{setting.name} = " in text
        assert setting.allowed
        assert setting.meaning, setting.name
    wiring = {} if "serial" in kind.wires else {"can": CanWiring()}
    if kind.dialects is None or "pus" in kind.dialects:
        Emulator(load_unit("roja1"), parse_scenario(text, "example"), **wiring)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (
            'kind = "clock.drift"\nppm = 1e9',
            r"faults\.1\.ppm: found 1000000000.0; allowed is a number from -100",
        ),
        (
            'kind = "clock.drift"\nppn = 1',
            r"faults\.1\.ppn: is not a known key; allowed are kind, start_s, end_s",
        ),
        ('kind = "clock.stop"', r"faults\.1\.kind: found 'clock.stop'; allowed are .*clock\.drift"),
        ("start_s = 1.0", r"faults\.1\.kind: is missing; allowed are .*clock\.drift"),
        ('kind = "clock.jump"\nend_s = 1\nstart_s = 2', r"faults\.1: end_s = 1 comes before start_s = 2"),
        ('kind = "memory.bit_upset"', r"faults\.1\.memory: is missing; allowed is one of 'catalogue'"),
        (
            'kind = "clock.jump"\nprobability = 0',
            r"faults\.1\.probability: found 0; allowed is a number over 0",
        ),
    ],
)
def test_a_scenario_with_a_wrong_fault(table: str, says: str, refused: Any, tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(f'[[faults]]\nkind = "clock.jump"\n\n[[faults]]\n{table}\n')
    with pytest.raises(ConfigurationError, match=says):
        parse_scenario(path.read_text(), str(path))
    arguments = ("run", "roja1", "--scenario", path, "--link", "none", "--seconds", "1")
    refused(*arguments, says=(str(path), "faults.1"))


def test_a_fault_that_the_unit_cannot_have(refused: Any, tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text('[[faults]]\nkind = "memory.bit_upset"\nmemory = "program"\naddress = 131072\n')
    refused(
        *("run", "roja1", "--scenario", path, "--link", "none", "--seconds", "1"),
        says=(f"{path}: faults.0: memory.bit_upset: address: found 131072; allowed is", "from 0 to 131071"),
    )


def test_the_guides_examples_run() -> None:
    text = GUIDE.read_text(encoding="utf-8")
    tables = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert len(tables) == 2
    for table in tables:
        assert parse_scenario(table, "guide").faults
    first, second = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict[str, Any] = {}
    exec(first + second, names)
    emulator = names["emulator"]
    assert [one.settings.kind for one in emulator.faults.all] == ["clock.drift", "own.long_messages"]
    assert [one.active for one in emulator.faults.all] == [False, True]
