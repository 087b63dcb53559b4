"""Three units on one vcan0, each with an OBC of its own, in real time; the bus, read by others' software."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack

import cantools
import numpy as np
import pytest

from hil_tests.cli.live import LiveUnit
from st_emulator.obc import Obc

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

SECONDS = 60
PATIENCE_S = 60.0  # only bounds a hang
NODES = {1: (84.0, -1.5), 2: (210.0, 54.0), 3: (56.0, 24.0)}  # node: where its unit looks, deg
UNIT = "roja1"
CANDUMP_LINE = re.compile(r"\((\d+\.\d+)\) (\S+) ([0-9A-F]+)#([0-9A-F]*)$")

SCENARIO = """schema = 1
name = "three"
start_utc = "2026-01-15T00:00:00Z"
seed = {node}

[trajectory]
kind = "inertial"
ra_deg = {ra}
dec_deg = {dec}
roll_deg = 10.0
"""


def error_arcsec(measured: np.ndarray, true: np.ndarray) -> float:
    """The angle between two attitudes (a small one), by the vector part of the quaternion between them."""
    x, y, z, w = measured
    a, b, c, d = true
    vector = np.array(
        [
            d * x - a * w - b * z + c * y,
            d * y - b * w - c * x + a * z,
            d * z - c * w - a * y + b * x,
        ]
    )
    return float(2 * np.degrees(np.linalg.norm(vector)) * 3600)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory):
    """The minute: OBCs that acquire and listen, truth and journals of the units, candump's log."""
    folder = tmp_path_factory.mktemp("three")
    candump = shutil.which("candump")
    assert candump is not None, "candump of can-utils is missing"
    log = (folder / "candump.log").open("w")
    with ExitStack() as stack:
        stack.enter_context(log)
        listener = subprocess.Popen([candump, "-L", "vcan0"], stdout=log)
        stack.callback(listener.wait)
        stack.callback(listener.terminate)
        obcs, units = {}, {}
        for node, (ra, dec) in NODES.items():
            obcs[node] = stack.enter_context(Obc.connect("can:socketcan/vcan0", unit=UNIT, node=node))
            scenario = folder / f"{node}.toml"
            scenario.write_text(SCENARIO.format(node=node, ra=ra, dec=dec))
            units[node] = LiveUnit(
                UNIT, "--link", "can:socketcan/vcan0", "--node", str(node), "--scenario", scenario,
                "--journal", folder / f"{node}.journal", "--truth", folder / f"{node}.truth",
            )  # fmt: skip
        for node, unit in units.items():
            unit.await_running()
            obcs[node].wait_for_event("BOOT_COMPLETED", timeout_s=PATIENCE_S, since=0)
        for obc in obcs.values():
            obc.acquire(timeout_s=PATIENCE_S)
        begun = time.monotonic()
        while time.monotonic() - begun < SECONDS:
            for obc in obcs.values():
                obc.ping(timeout_s=PATIENCE_S)
                obc.wait(0.3)
        for obc in obcs.values():
            obc.shutdown(timeout_s=PATIENCE_S)
        time.sleep(0.5)
        for unit in units.values():
            unit.stop(15)
        figures = {
            node: (obc.attitudes(), obc.counters.as_dict(), obc.cyclic_attitudes())
            for node, obc in obcs.items()
        }
    truth = {
        node: {
            record["frame_index"]: np.array(record["q_icrs_to_sensor"])
            for record in map(json.loads, (folder / f"{node}.truth").read_text().splitlines())
        }
        for node in NODES
    }
    return folder, figures, truth


def test_every_attitude_came_once_and_in_order(session) -> None:
    _, figures, _ = session
    for attitudes, counters, _ in figures.values():
        frames = [attitude.frame_index for attitude in attitudes]
        assert len(frames) >= 4 * SECONDS - 8
        assert frames == list(range(frames[0], frames[0] + len(frames)))
        assert counters["sequence_gaps"] == counters["crc_errors"] == counters["malformed"] == 0
        assert counters["telecommands_verified"] == counters["telecommands_sent"] >= SECONDS / 2


def test_none_was_mixed_up_with_another_units(session) -> None:
    _, figures, truth = session
    for node, (attitudes, _, _) in figures.items():
        valid = [attitude for attitude in attitudes if attitude.valid]
        assert len(valid) >= 4 * SECONDS - 16
        for attitude in valid:
            assert error_arcsec(np.array(attitude.q_icrs_to_sensor), truth[node][attitude.frame_index]) < 30


def test_the_cyclic_halves_make_the_same_attitudes(session) -> None:
    _, figures, _ = session
    for attitudes, _, cyclic in figures.values():
        reported = {attitude.frame_index & 0xFF: attitude for attitude in attitudes[-200:]}
        assert len(cyclic) >= 4 * SECONDS - 8
        for attitude in cyclic[-150:]:
            twin = reported[attitude.counter]
            assert np.allclose(attitude.q_icrs_to_sensor, twin.q_icrs_to_sensor, rtol=0, atol=2.0**-28)


def test_candumps_log_decodes_wholly_with_the_exported_dbc(session) -> None:
    folder, figures, _ = session
    dbc = subprocess.run(
        [sys.executable, "-m", "st_emulator", "export", "dbc", *(f"{UNIT}:{node}" for node in NODES)],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    database = cantools.database.load(io.StringIO(dbc), "dbc")
    names: dict[str, int] = {}
    for line in (folder / "candump.log").read_text().splitlines():
        match = CANDUMP_LINE.match(line)
        assert match is not None, line
        message = database.get_message_by_frame_id(int(match[3], 16))
        message.decode(bytes.fromhex(match[4]))
        names[message.name] = names.get(message.name, 0) + 1
    for node, (attitudes, _, _) in figures.items():
        for frame in ("attitude_1", "attitude_2", "status", "rates", "mid_exposure_time"):
            assert names[f"{UNIT}_{node}_{frame}"] == len(attitudes)
