"""``st-emulator run --lockstep`` and ``--control``: a unit in a process of its own, its client in another."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from hil_tests.cli.live import PATIENCE_S, LiveUnit
from st_emulator.bench.scenario import parse_scenario
from st_emulator.commands.running import RunOptions
from st_emulator.drivers.lockstep import Lockstep
from st_emulator.links import open_link, parse_link
from st_emulator.lockstep_client import ControlError, LockstepClient
from st_emulator.units.profile import load_unit

SCENARIO = "[parameters]\nautonomous_start = 1\n"
STEPS = 1000
MS = 1_000_000

#: The client's process: 1,000 steps with truth of its own, and what the unit sent.
CLIENT = """
import json, sys, time
from st_emulator.lockstep_client import LockstepClient
from hil_tests.cli.test_lockstep_command import drive
host, port, token_file, out = sys.argv[1:]
with LockstepClient.of_file(host, int(port), token_file) as unit:
    begun = time.monotonic()
    groups = drive(unit)
    rate = 1000 / (time.monotonic() - begun)
with open(out, "w") as file:
    json.dump({"groups": [[t, d.hex()] for t, d in groups], "rate": rate}, file)
"""


def truth_at(t_ns: int) -> tuple[list[float], list[float]]:
    """Any attitude that turns: about z, 0.1 deg/s, as (quaternion, rate)."""
    import math

    half = math.radians(0.1) * t_ns * 1e-9 / 2
    return [0.0, 0.0, math.sin(half), math.cos(half)], [0.0, 0.0, math.radians(0.1)]


def drive(unit: Any) -> list[tuple[int, bytes]]:
    """1,000 steps of 10 ms: of the socket's client and of the unit in this process alike."""
    unit.set_attitude(0, *truth_at(0))
    for number in range(1, STEPS + 1):
        unit.set_attitude(number * 10 * MS, *truth_at(number * 10 * MS))
        unit.step_to(number * 10 * MS)
    groups: list[tuple[int, bytes]] = unit.take_groups()
    return groups


def control_of(ready: Path, unit: LiveUnit) -> dict[str, Any]:
    deadline = time.monotonic() + PATIENCE_S
    while not ready.exists():
        assert time.monotonic() < deadline, unit.said
        assert unit.process.poll() is None, unit.said
        time.sleep(0.02)
    control: dict[str, Any] = json.loads(ready.read_text())["control"]
    return control


def scenario_in(folder: Path) -> Path:
    path = folder / "scenario.toml"
    path.write_text(SCENARIO)
    return path


def test_a_client_in_another_process_gives_the_bytes_of_this_one(tmp_path):
    ready, journal, out = tmp_path / "ready.json", tmp_path / "journal.jsonl", tmp_path / "out.json"
    with LiveUnit(
        *("roja1", "--scenario", scenario_in(tmp_path), "--lockstep", "127.0.0.1:0", "--json", ready),
        *("--attitude", "outside", "--journal", journal),
    ) as unit:
        control = control_of(ready, unit)
        token_file = Path(control["token_file"])
        assert stat.S_IMODE(token_file.stat().st_mode) == 0o600
        client = subprocess.run(
            [sys.executable, "-c", CLIENT, control["host"], str(control["port"]), str(token_file), str(out)],
            capture_output=True, text=True, timeout=PATIENCE_S, cwd=Path(__file__).parents[2],
        )  # fmt: skip
        assert client.returncode == 0, client.stderr
        assert unit.stop(signal.SIGTERM) == 0
    assert any(line.startswith("lockstep on 127.0.0.1:") for line in unit.said)
    assert not any(token_file.name in line and "token=" in line for line in unit.said)
    assert not token_file.exists()  # it was of this run alone
    here = drive(Lockstep.of(load_unit("roja1"), parse_scenario(SCENARIO, "here")))
    there = [(t_ns, bytes.fromhex(data)) for t_ns, data in json.loads(out.read_text())["groups"]]
    assert len(here) > 100
    assert there == here
    replay = subprocess.run(
        [sys.executable, "-m", "st_emulator", "replay", str(journal)], capture_output=True, timeout=PATIENCE_S
    )
    assert replay.returncode == 0, replay.stdout


def test_a_client_that_is_killed_leaves_the_unit_paused_and_another_goes_on(tmp_path):
    ready, token = tmp_path / "ready.json", tmp_path / "token"
    with LiveUnit(
        *("roja1", "--lockstep", "localhost:0", "--json", ready, "--lockstep-token-file", token)
    ) as unit:
        control = control_of(ready, unit)
        program = (
            "import sys, time\nfrom st_emulator.lockstep_client import LockstepClient\n"
            f"u = LockstepClient.of_file({control['host']!r}, {control['port']}, {str(token)!r})\n"
            "u.step_to(700_000_000); print('there', flush=True); time.sleep(600)"
        )
        first = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        assert first.stdout is not None
        assert first.stdout.readline() == "there\n"
        with pytest.raises(ControlError, match="busy"):
            LockstepClient.of_file(control["host"], control["port"], token)
        first.kill()
        first.wait()
        first.stdout.close()
        deadline = time.monotonic() + PATIENCE_S
        while not any("gone without a word" in line for line in unit.said):
            assert time.monotonic() < deadline, unit.said
            time.sleep(0.02)
        with LockstepClient.of_file(control["host"], control["port"], token) as second:
            assert second.hello["now_ns"] == 700 * MS
            assert second.paused_because == "the client has gone without a word"
            with pytest.raises(ControlError, match="paused") as told:
                second.step_frame()
            assert told.value.kind == "paused"
            second.resume()
            assert second.step_to(800 * MS) == 800 * MS
        assert unit.stop(signal.SIGINT) == 0
        assert token.exists()  # the user's own


def test_a_run_ends_at_its_end(tmp_path):
    ready = tmp_path / "ready.json"
    with LiveUnit("roja1", "--lockstep", "[::1]:0", "--json", ready, "--seconds", "2") as unit:
        control = control_of(ready, unit)
        with LockstepClient.of_file(control["host"], control["port"], control["token_file"]) as client:
            with pytest.raises(ControlError, match="the run ends at 2000000000 ns"):
                client.step_to(2000 * MS + 1)
            with pytest.raises(ControlError, match="the truth of this run is the scenario's"):
                client.set_attitude(0, [0, 0, 0, 1])
            assert client.step_to(2000 * MS) == 2000 * MS
        assert unit.wait() == 0
    assert any("stopped at 2.000 s" in line for line in unit.said)


def test_an_obc_on_a_pty_beside_it(tmp_path):
    from hil_tests.vectors import reference_decoder as wire

    ready, journal, port = tmp_path / "ready.json", tmp_path / "journal.jsonl", tmp_path / "tracker"
    with LiveUnit(
        *(
            "roja1",
            "--lockstep",
            "127.0.0.1:0",
            "--json",
            ready,
            "--link",
            f"pty:{port}",
            "--journal",
            journal,
        ),
        *("--store", "none"),
    ) as unit:
        control = control_of(ready, unit)
        with (
            LockstepClient.of_file(control["host"], control["port"], control["token_file"]) as client,
            open_link(parse_link(f"serial:{port}"), "obc", 115200, "roja1", 0) as obc,
        ):
            client.step_to(700 * MS)
            obc.write(
                wire.slip_frame(
                    wire.encode_telecommand(
                        "ping", {}, apid=load_unit("roja1").apid, sequence_count=0, source_id=1, ack=15
                    )
                )
            )
            client.step_to(900 * MS)
            sent = client.take()
            heard = b""
            deadline = time.monotonic() + PATIENCE_S
            while len(heard) < len(sent):
                assert time.monotonic() < deadline
                heard += obc.read()
            assert heard == sent
        assert unit.stop(signal.SIGTERM) == 0
    received = [json.loads(line) for line in journal.read_text().splitlines() if '"rx"' in line]
    assert [entry["t_ns"] for entry in received] == [700 * MS]
    names = [wire.decode_telemetry(frame)["name"] for frame in wire.slip_frames(sent)]
    assert "ping_reply" in names or any("completion" in name for name in names), names


def test_a_paced_unit_is_looked_into(tmp_path):
    ready = tmp_path / "ready.json"
    with LiveUnit("roja1", "--link", "none", "--control", "127.0.0.1:0", "--json", ready) as unit:
        control = control_of(ready, unit)
        assert control["time"] == "paced"
        with LockstepClient.of_file(control["host"], control["port"], control["token_file"]) as client:
            before = client.truth()
            with pytest.raises(ControlError, match="started with --lockstep"):
                client.step_frame()
            deadline = time.monotonic() + PATIENCE_S
            while client.truth()["mode"] != "STANDBY":
                assert time.monotonic() < deadline
            assert client.truth()["t_ns"] > before["t_ns"]
            assert client.counters()["boot_count"] == 1
            with pytest.raises(ControlError, match="has processed none"):
                client.truth_of_frame(0)
            client.power(False)
            assert client.state()["mode"] == "OFF"
            client.power(True)
            assert client.state()["mode"] == "BOOT"
            assert client.counters()["boot_count"] == 2
        assert unit.stop(signal.SIGTERM) == 0


def test_the_token_is_no_others_business(refused, tmp_path):
    token = tmp_path / "token"
    token.write_text("x" * 32)
    token.chmod(0o644)
    run = ("run", "roja1", "--lockstep", "127.0.0.1:0", "--lockstep-token-file", token)
    refused(*run, says=(str(token), "mode 644", "chmod 600"))
    token.chmod(0o600)
    for content in ("", "short", "two words of a token here", "\x00" * 20, "x" * 600):
        token.write_text(content)
        refused(*run, says=(str(token), "holds no token", "16 to 512"))
    token.write_bytes(b"\xff" * 20)
    refused(*run, says=("holds no text",))
    token.unlink()
    token.mkdir(mode=0o700)
    refused(*run, says=(str(token),))


WRONG = {
    "not loopback": (("--lockstep", "0.0.0.0:5000"), ("--lockstep 0.0.0.0:5000", "127.0.0.1:PORT")),
    "no port": (("--control", "localhost"), ("--control localhost", "PORT")),
    "both": (("--lockstep", "127.0.0.1:0", "--control", "127.0.0.1:0"), ("--control", "one of them")),
    "speed": (("--lockstep", "127.0.0.1:0", "--speed", "2"), ("--speed 2", "owns the time")),
    "max": (("--control", "127.0.0.1:0", "--speed", "max", "--seconds", "1"), ("--control", "0.01")),
    "attitude": (("--attitude", "mine"), ("--attitude mine", "scenario and outside")),
    "attitude without": (("--attitude", "outside"), ("--attitude outside", "--lockstep")),
    "token without": (("--lockstep-token-file", "x"), ("--lockstep-token-file x", "only with --lockstep")),
}


@pytest.mark.parametrize("name", WRONG)
def test_options_that_do_not_go_together(refused, name):
    options, says = WRONG[name]
    refused("run", "roja1", *options, says=says)


def test_a_port_that_is_taken(tmp_path):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        run = subprocess.run(
            [sys.executable, "-m", "st_emulator", "run", "roja1", "--lockstep", f"127.0.0.1:{port}", "-q"],
            capture_output=True, text=True, timeout=PATIENCE_S, env={**os.environ},
        )  # fmt: skip
    assert run.returncode == 2
    assert "cannot be opened: Address already in use" in run.stderr


def test_a_client_imports_little():
    program = (
        "import sys, json\nimport st_emulator.lockstep_client\n"
        "own = sorted(n for n in sys.modules if n.startswith('st_emulator'))\n"
        "print(json.dumps(own), 'numpy' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE_S)
    assert run.stdout.strip() == (
        '["st_emulator", "st_emulator.drivers", "st_emulator.drivers.lockstep_wire", '
        '"st_emulator.lockstep_client"] False'
    )


def test_it_is_off_by_default():
    options = RunOptions("roja1")
    assert (options.lockstep, options.control) == (None, None)
