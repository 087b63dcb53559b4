"""A unit that tracks at its frame rate in real time, pinged all the while: delays above the modelled ones."""

from __future__ import annotations

import random
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from running_unit import NS_PER_S, Arrival, RunningUnit
from spread import of_delays

from st_emulator.bench.journal import Journal, read_journal
from st_emulator.drivers.realtime import ahead_of_others
from st_emulator.obc.listening import TelemetryListener
from st_emulator.protocol.framing import slip_encode
from st_emulator.protocol.pus.enumerations import Mode
from st_emulator.protocol.pus.registry import encode_telecommand
from st_emulator.units.profile import UnitProfile, load_unit
from st_emulator.wire.serial_line import BITS_PER_BYTE

TRACKING_TIMEOUT_S = 60.0
PONG_TIMEOUT_S = 2.0
PAUSE_S = (0.02, 0.1)  # between a pong and the next ping, random: all phases of the frame are met
SEED = 1


@dataclass
class Pinged:
    """A ping's sending and its pong's reception, monotonic ns."""

    sent_ns: int
    received_ns: int | None = None


def measure(unit: str, seconds: float, at_ping: Callable[[], None]) -> dict[str, Any]:
    """Ping and jitter figures of ``seconds`` of tracking.

    The OBC's end has the priority that the emulator's loop gives itself, where the system allows it: what is
    measured is the emulator and the line, not how long the one who measures waits for a processor.
    """
    with tempfile.TemporaryDirectory(prefix="st-emulator-bench-") as folder:
        with RunningUnit(unit, Path(folder)) as running, ahead_of_others() as priority:
            profile = load_unit(unit)
            await_tracking(running)
            arrivals, pings = ping_for(running, profile, seconds, at_ping)
            memory = running.memory_mb()
        journal = read_journal(running.journal)
    reports = [arrival for arrival in arrivals if arrival.telemetry.name == "attitude_report"]
    lost = sum(Mode(arrival.telemetry.fields["mode"]) is not Mode.TRACKING for arrival in reports)
    return {
        "seconds": seconds,
        "frames": len(reports),
        "frames_not_tracking": lost,
        "frames_late_or_dropped": sum(
            arrival.telemetry.fields["late"] + arrival.telemetry.fields["frames_dropped_before"]
            for arrival in reports
        ),
        "malformed": running.malformed,
        "ping": ping_figures(profile, pings, journal),
        "jitter": jitter_figures(reports, journal),
        "memory_mb": {name: round(value, 1) for name, value in memory.items()},
        "real_time_priority": priority,
    }


def await_tracking(running: RunningUnit) -> None:
    """Wait until the unit tracks."""
    deadline_ns = time.monotonic_ns() + round(TRACKING_TIMEOUT_S * NS_PER_S)
    while time.monotonic_ns() < deadline_ns:
        for arrival in running.receive(deadline_ns):
            if arrival.telemetry.fields.get("mode") == Mode.TRACKING:
                return
    raise SystemExit(f"the unit does not track within {TRACKING_TIMEOUT_S:g} s")


def ping_for(
    running: RunningUnit, profile: UnitProfile, seconds: float, at_ping: Callable[[], None]
) -> tuple[list[Arrival], list[Pinged]]:
    """Ping at random times, one after the other; everything that arrived, and the pings."""
    chance = random.Random(SEED)
    arrivals: list[Arrival] = []
    pings: list[Pinged] = []
    end_ns = time.monotonic_ns() + round(seconds * NS_PER_S)
    while time.monotonic_ns() < end_ns:
        next_ns = time.monotonic_ns() + round(chance.uniform(*PAUSE_S) * NS_PER_S)
        while time.monotonic_ns() < next_ns:
            arrivals += running.receive(next_ns)
        # No report of acceptance or completion comes before or after the pong.
        packet = encode_telecommand(
            "ping", apid=profile.apid, sequence_count=len(pings) & 0x3FFF, source_id=0, ack=0
        )
        ping = Pinged(running.send(slip_encode(packet)))
        pings.append(ping)
        at_ping()
        give_up_ns = ping.sent_ns + round(PONG_TIMEOUT_S * NS_PER_S)
        while ping.received_ns is None and time.monotonic_ns() < give_up_ns:
            for arrival in running.receive(give_up_ns):
                arrivals.append(arrival)
                if arrival.telemetry.name == "pong":
                    ping.received_ns = arrival.time_ns
    return arrivals, pings


def ping_figures(profile: UnitProfile, pings: Sequence[Pinged], journal: Journal) -> dict[str, Any]:
    """Round trips above what the line and the unit's latency take.

    The modelled delay is that between the ping's and the pong's virtual times in the journal. Where the line
    was free it is line time of the ping + telecommand latency + line time of the pong, taken from the unit
    file here; where other telemetry was on the line, the wait for it comes on top.
    """
    received = [entry for entry in journal.entries if entry.direction == "rx"]
    pongs = packets_by_time(journal, "pong")
    if len(received) != len(pings) or len(pongs) != len(pings):
        raise SystemExit(f"{len(pings)} pings were sent, {len(received)} received, {len(pongs)} pongs came")
    excess_ms, free_excess_ms = [], []
    for ping, request, (pong_ns, pong_bytes) in zip(pings, received, pongs, strict=True):
        modelled_ns = pong_ns - request.t_ns
        assert ping.received_ns is not None
        excess_ms.append((ping.received_ns - ping.sent_ns - modelled_ns) * 1e-6)
        line_ns = (len(request.data) + pong_bytes) * BITS_PER_BYTE * NS_PER_S / profile.wire.baud
        plain_ns = line_ns + profile.timing.telecommand_latency_us * 1000
        if abs(modelled_ns - plain_ns) < 1000:
            free_excess_ms.append((ping.received_ns - ping.sent_ns - plain_ns) * 1e-6)
    return {
        "above_modelled_delay": of_delays(excess_ms),
        "above_modelled_delay_line_free": of_delays(free_excess_ms),
        "modelled_delay_line_free_ms": round(plain_delay_ms(profile, received[0].data, pongs[0][1]), 4),
    }


def plain_delay_ms(profile: UnitProfile, request: bytes, pong_bytes: int) -> float:
    line_s = (len(request) + pong_bytes) * BITS_PER_BYTE / profile.wire.baud
    return line_s * 1e3 + profile.timing.telecommand_latency_us * 1e-3


def jitter_figures(reports: Sequence[Arrival], journal: Journal) -> dict[str, Any]:
    """Arrival of each attitude report's last byte against its virtual time, without the constant offset."""
    listener = listen(journal)
    left_ns = {
        packet.fields["frame_index"]: t_ns
        for t_ns, packet in listener.packets
        if packet.name == "attitude_report"
    }
    delay_ms = np.array(
        [(report.time_ns - left_ns[report.telemetry.fields["frame_index"]]) * 1e-6 for report in reports]
    )
    return {
        "about_median": of_delays(list(np.abs(delay_ms - np.median(delay_ms)))),
        "after_earliest": of_delays(list(delay_ms - delay_ms.min())),
    }


def listen(journal: Journal) -> TelemetryListener:
    listener = TelemetryListener()
    for entry in journal.entries:
        if entry.direction == "tx":
            listener.transmitted(entry.data, entry.t_ns)
    return listener


def packets_by_time(journal: Journal, name: str) -> list[tuple[int, int]]:
    """(virtual time of the last byte, bytes on the line) of each packet of one message."""
    return [
        (t_ns, len(slip_encode(packet.raw)))
        for t_ns, packet in listen(journal).packets
        if packet.name == name
    ]
