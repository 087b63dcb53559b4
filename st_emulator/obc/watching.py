"""The live view: what the unit says now, on one screen."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table

from ..naming import name_of
from ..protocol.pus.enumerations import Mode, Reason, TimeStatus
from .attitude import Attitude
from .client import Obc
from .counters import CanCounters
from .cuc_time import seconds, utc_from_cuc

REFRESH_S = 0.25
SHOWN_EVENTS = 6
ARCSEC_PER_RAD = 206_264.806


def attitude_line(attitude: Attitude) -> str:
    """One attitude report in one line."""
    head = f"frame {attitude.frame_index:6}  {name_of(Mode, int(attitude.mode)):13}"
    if not attitude.valid:
        rate = "" if attitude.rate_rad_s is None else f"  rate {rate_text(attitude)}"
        return f"{head}  not valid: {name_of(Reason, int(attitude.reasons))}{rate}"
    ra, dec, roll = attitude.pointing_deg
    return (
        f"{head}  ra {ra:10.5f}  dec {dec:+9.5f}  roll {roll:9.4f} deg  "
        f"stars {attitude.stars_identified}/{attitude.spots_detected}"
    )


def rate_text(attitude: Attitude) -> str:
    """The rate of an attitude report, with its accuracy where the unit tells it."""
    if attitude.rate_rad_s is None:
        return "not valid"
    x, y, z = np.degrees(attitude.rate_rad_s)
    text = f"x {x:+.5f}  y {y:+.5f}  z {z:+.5f} deg/s"
    if attitude.rate_sigma_rad_s is None:
        return text
    x, y, z = ARCSEC_PER_RAD * attitude.rate_sigma_rad_s
    return f"{text}, 1 sigma x {x:.2f}  y {y:.2f}  z {z:.2f} arcsec/s"


def live_table(obc: Obc) -> Table:
    """Mode, attitude, rate, stars, processing, counters and last events as a table of two columns."""
    whom = [f"{name} {value}" for name, value in obc.transport.description.items() if value is not None]
    title = ", ".join([obc.link.name, *whom, f"APID 0x{obc.destination_apid:X}"])
    table = Table(title=title, title_justify="left", box=None)
    table.add_column("", style="bold", no_wrap=True)
    table.add_column("")
    unit = obc.unit
    table.add_row("mode", "unknown" if unit.mode is None else unit.mode.name)
    attitudes = obc.attitudes()
    if attitudes:
        _attitude_rows(table, attitudes[-1])
        telemetry = unit.latest["attitude_report"]
        if telemetry.time_status == TimeStatus.SET:
            table.add_row("time", utc_from_cuc(telemetry.time).isoformat(timespec="milliseconds"))
        else:
            table.add_row("time", f"not set, {seconds(telemetry.time):.3f} s since the start")
        frames = ", ".join(f"{name_of(Mode, mode)} {count}" for mode, count in unit.frames_by_mode.items())
        table.add_row("frames", frames)
    else:
        table.add_row("attitude", "no report yet")
    counters = obc.counters
    table.add_row(
        "telemetry",
        f"{counters.packets} packets, {counters.crc_errors} CRC errors, {counters.malformed} malformed, "
        f"{counters.framing_errors} framing errors, {counters.missing_packets} missing",
    )
    table.add_row(
        "telecommands",
        f"{counters.telecommands_sent} sent, {counters.telecommands_verified} verified, "
        f"{counters.telecommands_failed} failed, {counters.telecommands_timed_out} timed out",
    )
    if isinstance(counters, CanCounters):
        table.add_row(
            "CAN bus",
            f"{counters.frames_received} frames, {counters.cyclic_frames} cyclic, "
            f"{counters.frames_of_others} of others, {counters.error_frames} error frames",
        )
        failed = counters.receptions_failed + counters.transmissions_failed
        table.add_row(
            "transfers",
            f"{counters.transfers_received} received, {counters.transfers_sent} sent, {failed} failed, "
            f"{counters.transfer_frames_ignored} frames ignored",
        )
    for event in obc.events()[-SHOWN_EVENTS:]:
        table.add_row(f"{(event.received_ns - obc.started_ns) / 1e9:.1f} s", str(event))
    return table


def _attitude_rows(table: Table, attitude: Attitude) -> None:
    if attitude.valid:
        ra, dec, roll = attitude.pointing_deg
        table.add_row("attitude", f"ra {ra:.5f}  dec {dec:+.5f}  roll {roll:.4f} deg")
        sigma = [ARCSEC_PER_RAD * attitude.covariance_rad2[axis, axis] ** 0.5 for axis in range(3)]
        table.add_row("1 sigma", f"x {sigma[0]:.2f}  y {sigma[1]:.2f}  z {sigma[2]:.2f} arcsec")
    else:
        table.add_row("attitude", f"not valid: {name_of(Reason, int(attitude.reasons))}")
    table.add_row("rate", rate_text(attitude))
    table.add_row(
        "stars",
        f"{attitude.stars_identified} identified of {attitude.spots_detected} spots, residual "
        f"{attitude.residual_rms_arcsec:.2f} arcsec, window +-{attitude.window_half_width_px} px",
    )
    late = ", late" if attitude.late else ""
    table.add_row(
        "processing", f"{attitude.cycles / 1e6:.2f} million cycles, {attitude.latency_us / 1000:.1f} ms{late}"
    )


def watch(obc: Obc, duration_s: float | None, console: Console | None = None) -> None:
    """Show the unit for so long, None: until Ctrl-C. Where there is no terminal, one line per attitude
    report.
    """
    console = Console() if console is None else console
    end_ns = None if duration_s is None else obc.now_ns() + round(duration_s * 1e9)
    try:
        if console.is_terminal:
            with Live(live_table(obc), console=console, auto_refresh=False) as live:
                while _wait(obc, end_ns):
                    live.update(live_table(obc), refresh=True)
            return
        shown = obc.mark()
        while True:
            going_on = _wait(obc, end_ns)
            for entry in obc.telemetry_since(shown):
                shown = entry.number + 1
                if entry.telemetry.name == "attitude_report":
                    attitude = Attitude.from_fields(entry.telemetry.fields, entry.time_ns)
                    console.print(attitude_line(attitude), markup=False, highlight=False, soft_wrap=True)
            if not going_on:
                return
    except KeyboardInterrupt:
        return


def _wait(obc: Obc, end_ns: int | None) -> bool:
    """Wait until the next look; False when it is the end."""
    left_s = REFRESH_S if end_ns is None else min(REFRESH_S, (end_ns - obc.now_ns()) / 1e9)
    if left_s > 0:
        obc.wait(left_s)
    return end_ns is None or obc.now_ns() < end_ns
