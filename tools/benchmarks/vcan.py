"""Telecommands over a real vcan0, above what the modelled bus and unit take; an image by ISO-TP."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import vcan_session
from ideal_obc import IdealObc
from spread import of_delays

from st_emulator.bench.journal import Journal, read_journal
from st_emulator.bench.scenario import parse_scenario
from st_emulator.clock import NS_PER_S
from st_emulator.protocol.can.transfer import FIRST, SINGLE, frame_kind
from st_emulator.units.profile import load_unit

SETTLE_S = 30.0  # start of the machine and the unit, the image at the end
PING = (17, 1)


def measure(unit: str, seconds: float, at_ping: Callable[[], None]) -> dict[str, Any]:
    """Delays from a ping's sending to the report of its completion, and the download of an image.

    The modelled delay of each ping is that of the same session in virtual time, with an OBC that answers the
    unit's flow control at once: what comes on top is the time of both processes, of the kernel and of the
    guest in which they run.
    """
    tool = Path(__file__).parents[1] / "vcan"
    with tempfile.TemporaryDirectory(prefix="st-emulator-bench-") as name:
        folder = Path(name)
        limit = str(round(2 * seconds + 10 * SETTLE_S))
        command = [
            *(str(tool), "-t", limit, "-w", name),
            *(sys.executable, vcan_session.__file__, unit, f"{seconds:g}", name),
        ]
        figures: dict[str, Any] = {}
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            for line in process.stdout:
                item = json.loads(line)
                if "ping" in item:
                    at_ping()
                else:
                    figures = item
        if process.returncode != 0 or not figures:
            raise SystemExit(f"{' '.join(command)}: ended with status {process.returncode}")
        journal = read_journal(folder / "journal.jsonl")
    begun_ns = telecommand_times(journal)[: len(figures["pings"])]
    modelled_ns = modelled_delays_ns(unit, begun_ns)
    excess_ms = [
        (ping["round_trip_ns"] - model_ns) * 1e-6
        for ping, model_ns in zip(figures["pings"], modelled_ns, strict=True)
    ]
    size = figures["image_bytes"]
    return {
        "seconds": seconds,
        "verification_above_modelled_delay": of_delays(excess_ms),
        "modelled_delay": of_delays([value * 1e-6 for value in modelled_ns]),
        "frames": figures["frames"],
        "frames_missing": figures["frames_missing"],
        "frames_late": figures["frames_late"],
        "counters": figures["counters"],
        "image": {
            "bytes": size,
            "seconds": figures["image_s"],
            "kbyte_per_s": round(size / figures["image_s"] / 1e3, 2),
        },
    }


def telecommand_times(journal: Journal) -> list[int]:
    """Virtual times at which the first frame of each telecommand came onto the bus."""
    identifier = 0x600 + int(journal.header["unit"]["can"]["node"])
    times = []
    for entry in journal.entries:
        if entry.direction != "rx":
            continue
        data = entry.data
        while data:
            word, length = struct.unpack_from(">IB", data)
            if word == identifier and frame_kind(data[8 : 8 + length]) in (FIRST, SINGLE):
                times.append(entry.t_ns)
            data = data[8 + length :]
    return times


def modelled_delays_ns(unit: str, begun_ns: list[int]) -> list[int]:
    """From each ping's first frame to its completion report's last, in the model alone."""
    obc = IdealObc(load_unit(unit), parse_scenario(vcan_session.SCENARIO, "bench"))
    for at_ns in begun_ns:
        obc.run_to(at_ns)
        obc.send("ping")
    obc.run_to(begun_ns[-1] + NS_PER_S)
    completed = [t_ns for t_ns, packet in obc.packets if packet.name == "completion_success"]
    if len(completed) != len(begun_ns):
        raise SystemExit(f"{len(begun_ns)} pings in the model, {len(completed)} completions")
    return [end_ns - start_ns for start_ns, end_ns in zip(begun_ns, completed, strict=True)]
