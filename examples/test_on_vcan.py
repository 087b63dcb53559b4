"""An integration test on vcan0: `./tools/vcan .venv/bin/python -m pytest examples/test_on_vcan.py`"""

import subprocess
import sys

from st_emulator.obc import Obc

LINK = "can:socketcan/vcan0"
UNIT = [sys.executable, "-m", "st_emulator", "run", "roja1", "--link", LINK, "--seconds", "15"]


def test_an_attitude_within_two_seconds():
    with Obc.connect(LINK, unit="roja1") as obc, subprocess.Popen(UNIT):
        obc.wait_for_event("BOOT_COMPLETED", timeout_s=60)
        obc.set_time_by_sync()  # SYNC and the time, as frames
        obc.acquire(timeout_s=2)
        assert obc.next("attitude_report").fields["valid"]
        assert obc.wait_for_cyclic("status").values["valid"]  # the same without a transport
