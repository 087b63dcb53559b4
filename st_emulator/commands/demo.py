"""``st-emulator demo``: a unit and an OBC as two processes over a pseudo-terminal or a CAN bus, in real time,
start to shutdown.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ..bench.journal import Journal, read_journal
from ..errors import ConfigurationError
from ..links import LinkError, parse_link
from ..obc import Obc, ObcError, TelemetryTimeout
from ..obc.listening import TelemetryListener
from ..protocol.pus.enumerations import EventId, Mode
from ..report import Check, all_hold, check, require_json_path, show_checks, show_figures, write_json
from ..tai import tai_ns_from_utc
from ..units.profile import UnitProfile, load_unit
from ..units.validation import validate
from ..world import quaternion
from .demo_session import START_UTC, Session, scenario_head
from .series import Series

if TYPE_CHECKING:
    from .turning_demo import TurnSeries

ARCSEC_PER_RAD = 180 / np.pi * 3600
SLEW_SHARE = (0.55, 0.8)  # of the run
PHASES = (
    (SLEW_SHARE[0], "tracking, at rest"),
    (SLEW_SHARE[1], "tracking, slew"),
    (1.0, "tracking, at rest"),
)
SHUTDOWN_S = 1.5  # before the end
TRACKING_SHARE_TARGET = 0.95
SLEW_RATE_SHARE = 0.8  # peak rate of the slew, of the unit's largest rate
MOST_SLEW_DEG = 3.0
START_TIMEOUT_S = 300.0  # a first start compiles the kernels
END_TIMEOUT_S = 10.0


def demo_scenario(profile: UnitProfile, seconds: float, seed: int) -> str:
    """The scenario of the demo: at rest, a slew below the unit's largest rate, at rest; TOML text."""
    start_s, end_s = (round(share * seconds, 2) for share in SLEW_SHARE)
    # A versine slew peaks at twice its mean rate.
    angle_deg = min(profile.tracking.rate_deg_s * SLEW_RATE_SHARE / 2 * (end_s - start_s), MOST_SLEW_DEG)
    return f"""{scenario_head(profile.name, "a slew", seconds, seed, 20.0)}
[[trajectory.segments]]
kind = "hold"
duration_s = {start_s:g}

[[trajectory.segments]]
kind = "slew_to"
duration_s = {end_s - start_s:g}
ra_deg = 84.0
dec_deg = {-1.5 - angle_deg:.4f}
roll_deg = 20.0
"""


@dataclass(frozen=True)
class Plan:
    """What a demo shows: its scenario; what is said until which share of the run; how it is judged, and the
    picture of it.
    """

    scenario: Callable[[UnitProfile, float, int], str]
    phases: tuple[tuple[float, str], ...]
    evaluate: Callable[
        [UnitProfile, float, Session, dict[int, dict[str, Any]]], tuple[dict[str, Any], list[Check], Any]
    ]
    draw: Callable[[UnitProfile, Any, Path, Path], None]


def plan_of(profile: UnitProfile) -> Plan:
    """A slew within the unit's tracking rate; for a unit that measures its rate alone, a turn far over it."""
    from . import turning_demo

    if turning_demo.turns(profile):
        return Plan(turning_demo.turn_scenario, turning_demo.PHASES, turning_demo.evaluate_turn, _draw_turn)
    return Plan(demo_scenario, PHASES, evaluate, _draw)


def demo_link(text: str, out: Path) -> tuple[str, Path | None]:
    """The link that both sides use, and the path by which a pseudo-terminal is found.

    Raises:
        ConfigurationError: a link that cannot join two processes of this computer.
    """
    specification = parse_link(text)
    if specification.kind == "can" and specification.interface != "virtual":
        return text, None
    if text == "pty":
        return f"pty:{out / 'tracker'}", out / "tracker"
    raise ConfigurationError(
        f"--link {text}: unit and OBC are two processes; allowed are pty and can:socketcan/CHANNEL"
    )


def run_demo(
    unit: str,
    seconds: float,
    json_path: str | None,
    out: Path,
    seed: int | None,
    console: Console,
    link_text: str = "pty",
) -> int:
    """Run the demo; exit status 0 when every check holds, else 1."""
    require_json_path(json_path)
    profile = load_unit(unit)
    plan = plan_of(profile)
    link, path = demo_link(link_text, out)
    scenario_path = out / "scenario.toml"
    try:
        out.mkdir(parents=True, exist_ok=True)
        _clear(out)
        scenario_path.write_text(
            plan.scenario(profile, seconds, 1 if seed is None else seed), encoding="utf-8"
        )
    except OSError as error:
        raise ConfigurationError(f"--out {out}: cannot be used: {error.strerror}") from error
    console.print(f"[bold]st-emulator demo[/]: {escape(profile.unit.title)}, {seconds:g} s in real time")
    command = [
        *(sys.executable, "-m", "st_emulator", "run", unit, "--quiet"),
        *("--link", link, "--scenario", str(scenario_path)),
        *("--journal", str(out / "journal.jsonl"), "--truth", str(out / "truth.jsonl"), "--store", "none"),
    ]
    before = None if path is None else _identity(path)
    with _ended_by_sigterm():
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            session = _operate(process, link, path, before, unit, profile, seconds, plan.phases, out, console)
        finally:
            said = _end(process)
    if process.returncode != 0:
        session.problem = "; ".join(
            text
            for text in (session.problem, f"the emulator ended with status {process.returncode}: {said}")
            if text
        )
    if session.problem:
        console.print(f"[red]{escape(session.problem)}[/]")
    figures, checks, series = plan.evaluate(profile, seconds, session, read_truth(out / "truth.jsonl"))
    picture = out / "demo.png"
    try:
        plan.draw(profile, series, out, picture)
        figures["picture"] = str(picture)
    except (OSError, ValueError, ConfigurationError) as error:
        console.print(f"[red]no picture: {escape(str(error))}[/]")
    show_figures(console, "demo", figures)
    show_checks(console, checks)
    console.print(f"journal, truth, telemetry and picture are in {escape(str(out))}/", soft_wrap=True)
    write_json(json_path, figures, checks)
    return 0 if all_hold(checks) and not session.problem else 1


def _clear(out: Path) -> None:
    """Remove what an earlier demo left: a recorder never writes over a recording, and an emulator that does
    not come up must not leave an old journal to be taken for its own.
    """
    folder = out / "telemetry"
    for path in (*folder.glob("*.jsonl"), *folder.glob("*.csv"), folder / "session.json"):
        path.unlink(missing_ok=True)
    for name in ("journal.jsonl", "truth.jsonl", "demo.png"):
        (out / name).unlink(missing_ok=True)


@contextlib.contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """In the block SIGTERM raises KeyboardInterrupt, as Ctrl-C does: no emulator is left behind."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _identity(link: Path) -> tuple[int, int] | None:
    """What tells one symbolic link from another that took its place."""
    try:
        status = link.lstat()
    except OSError:
        return None
    return status.st_ino, status.st_ctime_ns


def _end(process: subprocess.Popen[str]) -> str:
    """Wait for the emulator's own end, or bring it about; what it said on standard error."""
    try:
        if sys.exc_info()[0] is not None:
            process.terminate()
        for means in (process.terminate, process.kill):
            try:
                return process.communicate(timeout=END_TIMEOUT_S)[1].strip()
            except subprocess.TimeoutExpired:
                means()
        return process.communicate()[1].strip()
    except BaseException:
        process.kill()
        process.wait()
        raise


def _operate(
    process: subprocess.Popen[str],
    link: str,
    path: Path | None,
    before: tuple[int, int] | None,
    unit: str,
    profile: UnitProfile,
    seconds: float,
    phases: tuple[tuple[float, str], ...],
    out: Path,
    console: Console,
) -> Session:
    """The OBC's part: every telecommand of the demo, then listening to the end."""
    session = Session()
    with Progress(
        TextColumn("[bold]{task.fields[doing]:<34}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        task = progress.add_task("demo", total=seconds, doing="emulator starts")
        if path is not None:
            _await_link(process, path, before)
        try:
            obc = Obc.connect(link, unit=unit, apid=profile.apid, record=out / "telemetry")
        except LinkError as error:
            session.problem = f"the OBC could not connect: {error}"
            return session
        power_on_ns = obc.now_ns()  # until the unit's own time is known

        def elapsed_s() -> float:
            return (obc.now_ns() - power_on_ns) * 1e-9

        def do(doing: str) -> None:
            progress.update(task, completed=elapsed_s(), doing=doing)
            if not console.is_terminal:
                console.print(f"{elapsed_s():6.1f} s  {doing}")

        with obc:

            def command(doing: str, action: Any) -> None:
                do(doing)
                action()

            try:
                do("boot")
                power_on_ns = _await_boot(process, obc)
                command("self-test", obc.self_test)
                command("ping", obc.ping)
                start_ns = tai_ns_from_utc(START_UTC)
                command("set time", lambda: obc.set_time(start_ns + obc.now_ns() - power_on_ns))
                command("housekeeping on", lambda: obc.enable_housekeeping("TIMING"))
                session.acquire_ns = obc.now_ns()
                command("lost in space", obc.acquire)
                obc.wait_for_mode("TRACKING", timeout_s=10)
                for share, doing in phases:
                    do(doing)
                    until = min(share * seconds, seconds - SHUTDOWN_S)
                    while (left := until - elapsed_s()) > 0:
                        obc.wait(min(0.5, left))
                        progress.update(task, completed=elapsed_s())
                command("status", lambda: obc.housekeeping("STATUS"))
                command("shutdown", obc.shutdown)
                do("emulator ends")
                obc.wait(0.3)
            except (ObcError, LinkError) as error:
                session.problem = f"the OBC gave up: {error}"
            counters = obc.counters
            session.sent = counters.telecommands_sent
            session.verified = counters.telecommands_verified
            session.packets = counters.packets
            session.crc_errors = counters.crc_errors
            session.malformed = counters.malformed
            session.gaps = counters.sequence_gaps
            session.attitudes = obc.attitudes()
    return session


def _await_link(process: subprocess.Popen[str], link: Path, before: tuple[int, int] | None) -> None:
    """Wait for the emulator's link; one left behind by a killed emulator may lead to a terminal of somebody
    else by now.
    """
    deadline = time.monotonic() + START_TIMEOUT_S
    while _identity(link) in (None, before):
        if process.poll() is not None:
            said = process.stderr.read() if process.stderr is not None else ""
            raise ConfigurationError(f"the emulator did not start: {said.strip()}")
        if time.monotonic() > deadline:
            raise ConfigurationError(f"the emulator made no link {link} within {START_TIMEOUT_S:g} s")
        time.sleep(0.02)


def _await_boot(process: subprocess.Popen[str], obc: Obc) -> int:
    """Wait for the first sign of life and give the OBC's time of the unit's power-on.

    A late listener may have missed the boot event; housekeeping comes each second. Until its time is set the
    unit counts from power-on.
    """
    deadline = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            obc.wait_for("hk_report", timeout_s=0.5, since=0)
            break
        except TelemetryTimeout:
            if process.poll() is not None or time.monotonic() > deadline:
                raise
    last = obc.telemetry_since()[-1]
    return last.time_ns - last.telemetry.time.to_ns()


def read_truth(path: Path) -> dict[int, dict[str, Any]]:
    """Truth by frame index; empty without a file, and without the last line where a kill cut it short."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return {}
    truth: dict[int, dict[str, Any]] = {}
    for line in lines:
        try:
            record = json.loads(line)
        except json.JSONDecodeError:
            break
        truth[record["frame_index"]] = record
    return truth


def evaluate(
    profile: UnitProfile, seconds: float, session: Session, truth: dict[int, dict[str, Any]]
) -> tuple[dict[str, Any], list[Check], Series]:
    """Figures and checks from what the OBC received and from the truth by frame index.

    A frame after the first valid attitude of which no report came counts as not tracked. Errors are root mean
    squares over the valid attitudes at rest, cross-boresight per axis.
    """
    reports = [report for report in session.attitudes if report.frame_index in truth]
    errors, at_rest = [], []
    for report in reports:
        record = truth[report.frame_index]
        errors.append(
            quaternion.error_rotation_vector(report.q_icrs_to_sensor, record["q_icrs_to_sensor"])
            * ARCSEC_PER_RAD
        )
        at_rest.append(bool(np.linalg.norm(record["rate_rad_s"]) < 1e-12))
    error = np.array(errors).reshape(-1, 3)
    rest = np.array(at_rest, dtype=bool)
    valid = np.array([report.valid for report in reports], dtype=bool)
    mode = np.array([int(report.mode) for report in reports], dtype=np.int64)
    index = np.array([report.frame_index for report in reports], dtype=np.int64)
    t_s = np.array([truth[int(i)]["exposure_mid_ns"] * 1e-9 for i in index])
    first_valid = next((report for report in reports if report.valid), None)
    acquired_s = session.acquired_s(reports)
    tracking = valid & (mode == Mode.TRACKING)
    share = None
    if first_valid is not None and index.max() > first_valid.frame_index:
        after = index > first_valid.frame_index
        share = int(tracking[after].sum()) / int(index.max() - first_valid.frame_index)
    good = valid & rest
    cross = float(np.sqrt(np.mean(np.square(error[good, :2])))) if good.any() else None
    roll = float(np.sqrt(np.mean(np.square(error[good, 2])))) if good.any() else None
    figures: dict[str, Any] = {
        "unit": profile.name,
        "seconds": seconds,
        "frames": len(reports),
        "frames_tracking": int(tracking.sum()),
        "frames_inertial": int(good.sum()),
        "lost_in_space_s": acquired_s,
        "tracking_share": share,
        "cross_boresight_arcsec_rms": cross,
        "roll_arcsec_rms": roll,
        **session.figures(),
    }
    checks = [
        *session.checks(acquired_s),
        check("tracking_share", share, ">=", TRACKING_SHARE_TARGET, ""),
        check("overruns", figures["overruns"], "==", 0, "frames"),
    ]
    if profile.requirements.cross_boresight_arcsec is not None:
        target = profile.requirements.cross_boresight_arcsec
        checks.append(check("cross_boresight_arcsec_rms", cross, "<=", target, "arcsec"))
    return figures, checks, Series(t_s, mode, valid, rest, error, index, [(0.0, Mode.BOOT)])


def _draw(profile: UnitProfile, series: Series, out: Path, picture: Path) -> None:
    """A tracked frame (by replaying the journal up to it) above the run over time."""
    from .pictures import draw_run
    from .replaying import frame_of

    tracked = np.flatnonzero(series.valid & (series.mode == Mode.TRACKING))
    if not len(tracked):
        raise ValueError("no frame was tracked")
    journal_path = out / "journal.jsonl"
    index = int(series.frame_index[tracked[min(4, len(tracked) - 1)]])
    journal = read_journal(journal_path)
    series.modes[:] = mode_changes(journal)
    record = frame_of(journal, str(journal_path), index)
    if record is None:
        raise ValueError(f"frame {index} is not in the journal's replay")
    draw_run(profile, record, series, picture)


def _draw_turn(profile: UnitProfile, series: TurnSeries, out: Path, picture: Path) -> None:
    """Streaks, rates over time, and what the unit makes of them, from a replay of the journal."""
    from .turning_picture import draw_turn

    journal = read_journal(out / "journal.jsonl")
    series.modes[:] = mode_changes(journal)
    draw_turn(profile, series, journal, str(out / "journal.jsonl"), read_truth(out / "truth.jsonl"), picture)


def mode_changes(journal: Journal) -> list[tuple[float, Mode]]:
    """(time since power-on in s, mode from then on), from the events that a journal's unit sent."""
    wiring = journal.header.get("can")
    profile = validate(UnitProfile, journal.header["unit"], "journal")
    listener = TelemetryListener()
    if wiring is not None:
        listener = TelemetryListener(can=profile.can.identifier_table(wiring["node"]), fd=wiring["fd"])
    for entry in journal.entries:
        if entry.direction == "tx":
            listener.transmitted(entry.data, entry.t_ns)
    changes = [(0.0, Mode.BOOT)]
    for t_ns, packet in listener.packets:
        event = packet.fields.get("event_id")
        if event == EventId.BOOT_COMPLETED:
            changes.append((t_ns * 1e-9, Mode.STANDBY))
        elif event == EventId.MODE_CHANGED:
            changes.append((t_ns * 1e-9, Mode(packet.fields["data"]["to_mode"])))
        elif event == EventId.SHUTDOWN_STARTED:
            changes.append((t_ns * 1e-9, Mode.OFF))
    return changes
