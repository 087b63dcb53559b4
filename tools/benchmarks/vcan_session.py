"""Runs where there is a vcan0: a unit that tracks, an OBC that pings it and downloads an image; JSON lines.

Started by ``tools/bench`` through ``tools/vcan``. Lines on standard output: ``{"ping": 1}`` for each ping,
and last the figures. The journal stays in the folder given.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from pathlib import Path

from running_unit import SCENARIO

from st_emulator.drivers.realtime import ahead_of_others, quick_switching
from st_emulator.obc import Obc

LINK = "can:socketcan/vcan0"
PAUSE_S = (0.02, 0.1)  # between a completion and the next ping, random: all phases of the frame are met
SEED = 1
START_TIMEOUT_S = 60.0


def main(unit: str, seconds: float, folder: Path) -> None:
    scenario, journal = folder / "scenario.toml", folder / "journal.jsonl"
    scenario.write_text(SCENARIO, encoding="utf-8")
    command = [
        *(sys.executable, "-m", "st_emulator", "run", unit, "--quiet", "--link", LINK, "--store", "none"),
        *("--scenario", str(scenario), "--journal", str(journal)),
    ]
    chance = random.Random(SEED)
    # The OBC's threads have the priority that the emulator's loop gives itself: what is measured is the
    # emulator and the bus, not how long the one who measures waits for a processor.
    with (
        subprocess.Popen(command, stdin=subprocess.DEVNULL) as process,
        ahead_of_others(),
        quick_switching(),
        Obc.connect(LINK, unit=unit) as obc,
    ):
        try:
            obc.wait_for("hk_report", timeout_s=START_TIMEOUT_S, since=0)
            obc.wait_for_mode("TRACKING", timeout_s=START_TIMEOUT_S)
            obc.wait(1.0)
            pings = []
            first_attitude = len(obc.attitudes())
            end_ns = obc.now_ns() + round(seconds * 1e9)
            while obc.now_ns() < end_ns:
                obc.wait(chance.uniform(*PAUSE_S))
                done = obc.send("ping")
                assert done.completed_ns is not None
                pings.append({"round_trip_ns": done.completed_ns - done.sent_ns})
                print('{"ping": 1}', flush=True)
            attitudes = obc.attitudes()[first_attitude:]
            counters = obc.counters.as_dict()
            obc.capture_image()
            begun = time.monotonic()
            image = obc.fetch_image(timeout_s=20)
            image_s = time.monotonic() - begun
        finally:
            process.terminate()
            process.wait(20)
    frames = [attitude.frame_index for attitude in attitudes]
    print(
        json.dumps(
            {
                "pings": pings,
                "frames": len(frames),
                "frames_missing": frames[-1] - frames[0] + 1 - len(frames),
                "frames_late": sum(attitude.late for attitude in attitudes),
                "counters": counters,
                "image_bytes": image.pixels.nbytes,
                "image_s": round(image_s, 2),
            }
        )
    )


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), Path(sys.argv[3]))
