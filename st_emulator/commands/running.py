"""``st-emulator run``: options checked, files opened, the unit run paced or unpaced."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import math
import os
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from ..bench.emulator import Emulator
from ..bench.scenario import Scenario, load_scenario
from ..bench.scenario_inputs import check_inputs
from ..bench.trajectory_file import truth_ends_ns, with_content
from ..clock import NS_PER_S
from ..device.imaging import Lazy
from ..device.store import FileStore, Store, VolatileStore
from ..dialects.registry import dialect_of, require_wire, with_dialect
from ..drivers.lockstep import Lockstep
from ..drivers.lockstep_requests import Requests
from ..drivers.realtime import FrameWorker, StopSignal, run_lockstep, run_paced, run_unpaced
from ..drivers.supervisor_socket import SupervisorSocket
from ..errors import ConfigurationError
from ..firmware_model.modes import Mode
from ..links import Link, LinkSpecification, open_link, parse_link
from ..report import require_json_path
from ..tai import tai_ns_from_utc
from ..units.profile import UnitProfile, load_unit
from ..units.validation import validate
from ..wire.can.wiring import CanWiring
from ..world.recorded import RecordedFrames
from ..world.sampled import SampledTrajectory
from .controlling import Control, ControlOptions, control_options, open_control, token_for, write_ready
from .output_file import OutputFile
from .state_folder import state_folder
from .warm_up import compile_apart, warm_up


@dataclass(frozen=True)
class RunOptions:
    """The command line of ``run``."""

    unit: str
    dialect: str | None = None
    link: str | None = None
    node: int | None = None
    scenario: Path | None = None
    speed: str = "1"
    seed: int | None = None
    frames: Path | None = None
    hold: int = 8
    journal: Path | None = None
    truth: Path | None = None
    seconds: float | None = None
    store: str | None = None
    quiet: bool = False
    lockstep: str | None = None
    control: str | None = None
    token_file: Path | None = None
    attitude: str | None = None
    json_path: str | None = None
    supervisor: int | None = None


def parse_speed(text: str) -> float:
    """Times real time; infinity for ``max``."""
    if text == "max":
        return math.inf
    try:
        speed = float(text)
    except ValueError:
        speed = math.nan
    if not 0.01 <= speed <= 1000:
        raise ConfigurationError(f"--speed {text}: allowed are 1, a number from 0.01 to 1000, or max")
    return speed


def open_output(stack: contextlib.ExitStack, path: Path | None, option: str) -> OutputFile | None:
    return None if path is None else stack.enter_context(OutputFile(path, option))


def scenario_of(options: RunOptions, live: bool) -> Scenario:
    """The scenario asked for. Without one a live unit starts at the computer's date, as its OBC will set its
    time by a real clock; a unit without an OBC starts at a fixed date, so that every run is the same.
    """
    if options.scenario is not None:
        return with_content(load_scenario(options.scenario))
    return Scenario(start_utc=datetime.now(UTC)) if live else Scenario()


def within_truth(scenario: Scenario, duration_s: float | None) -> float | None:
    """How long a run lasts that was to last ``duration_s``: at most as long as its trajectory is known.

    Raises:
        ConfigurationError: it was to last longer.
    """
    ends_ns = truth_ends_ns(scenario, tai_ns_from_utc(scenario.start_utc))
    if ends_ns is None:
        return duration_s
    if duration_s is not None and math.isfinite(duration_s) and duration_s * NS_PER_S > ends_ns:
        raise ConfigurationError(
            f"{scenario.where}: the run is to last {duration_s:g} s, its trajectory's file "
            f"{ends_ns / NS_PER_S:.9g} s; allowed are runs that it covers"
        )
    return ends_ns / NS_PER_S if duration_s is None else duration_s


def open_store(
    stack: contextlib.ExitStack, options: RunOptions, profile: UnitProfile, live: bool
) -> tuple[Store, str]:
    """The unit's non-volatile memory and what to tell the user about it.

    Only a run on a line without a scenario keeps it by itself: the others are to give the same bytes each
    time.
    """
    if options.store == "none" or (options.store is None and not (live and options.scenario is None)):
        return VolatileStore(), "factory parameters, forgotten at the end"
    if options.store is not None:
        path = Path(options.store).expanduser()
        if path.is_dir():
            raise ConfigurationError(f"--store {path}: is a folder; allowed are a file's path or none")
        store = FileStore(path, profile.name)
        if not _locked(stack, path):
            raise ConfigurationError(
                f"--store {path}: another unit that runs has it; allowed are a file of its own or none"
            )
    else:
        # Each of several units of one kind that run at once has its own; alone it is always the first.
        for number in itertools.count(1):
            suffix = "" if number == 1 else f"-{number}"
            path = state_folder() / f"{profile.name}{suffix}.parameters.json"
            store = FileStore(path, profile.name)
            if _locked(stack, path):
                break
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigurationError(f"--store {path}: cannot be written: permission denied")
    return store, str(path)


def _locked(stack: contextlib.ExitStack, path: Path) -> bool:
    """Keep other units off a non-volatile memory while this one runs; False when another one has it."""
    try:
        file = stack.enter_context(path.with_name(path.name + ".lock").open("w", encoding="utf-8"))
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        raise ConfigurationError(f"--store {path}: cannot be written: {error.strerror}") from error
    return True


class _Watch:
    """What is done now and then while a unit runs: files are written out, a unit gone off is told."""

    def __init__(self, emulator: Emulator, console: Console) -> None:
        self._emulator = emulator
        self._console = console
        self._off = False

    def __call__(self) -> None:
        self._emulator.flush()
        off = self._emulator.device.mode == Mode.OFF
        if off and not self._off:
            self._console.print("the unit is off: nothing is sent any more (Ctrl-C ends)")
        self._off = off


def _say(text: str) -> None:
    """To who started the unit, also where it is to be quiet: a unit that waits for nobody is an error."""
    print(text, file=sys.stderr, flush=True)


@dataclass(frozen=True)
class RunPlan:
    """What the options come to, checked, before anything is opened. ``duration_s``: None, until stopped."""

    profile: UnitProfile
    scenario: Scenario
    specification: LinkSpecification
    speed: float
    duration_s: float | None
    frames: RecordedFrames | None
    control: ControlOptions | None

    @property
    def live(self) -> bool:
        """Whether there is a link."""
        return self.specification.kind != "none"

    @property
    def until_ns(self) -> int | None:
        return None if self.duration_s is None else round(self.duration_s * NS_PER_S)


def plan_of(options: RunOptions) -> RunPlan:
    """Everything that can be wrong with the options.

    Raises:
        ConfigurationError, LinkError, RecordedFrameError: something the user can mend.
    """
    speed = parse_speed(options.speed)
    control = control_options(
        lockstep=options.lockstep,
        control=options.control,
        token_file=options.token_file,
        attitude=options.attitude,
        speed=options.speed,
    )
    require_json_path(options.json_path)
    waits_for_nobody = speed != 1 or options.lockstep is not None
    link_text = options.link if options.link is not None else ("none" if waits_for_nobody else "pty")
    specification = parse_link(link_text)
    live = specification.kind != "none"
    if live and speed != 1:
        raise ConfigurationError(
            f"--speed {options.speed} with --link {link_text}: a live OBC keeps its own time, so only "
            "--speed 1 is allowed; use --link none (telecommands from the scenario) for other speeds"
        )
    if options.supervisor is not None and (speed == math.inf or options.lockstep is not None):
        raise ConfigurationError(
            f"--supervisor {options.supervisor}: allowed is a unit that keeps time, without --speed max and "
            "--lockstep"
        )
    if options.node is not None and specification.kind != "can":
        raise ConfigurationError(f"--node {options.node}: only with --link can:...; {link_text} has no nodes")
    profile = with_dialect(load_unit(options.unit), options.dialect)
    if live:
        require_wire(profile, specification.kind == "can", by_option=options.dialect is not None)
    scenario = scenario_of(options, live)
    check_inputs(profile, scenario)
    duration_s = options.seconds if options.seconds is not None else scenario.duration_s
    if options.attitude != "outside" and options.frames is None:
        duration_s = within_truth(scenario, duration_s)
    if duration_s is not None and not math.isfinite(duration_s):
        raise ConfigurationError(f"--seconds {duration_s:g}: allowed is a finite number of seconds")
    if duration_s is None and speed == math.inf:
        raise ConfigurationError("--speed max needs an end: give --seconds, or duration_s in the scenario")
    if options.journal is not None and options.journal == options.truth:
        raise ConfigurationError(f"--truth {options.truth}: is the journal too; allowed is a file of its own")
    frames = None
    if options.frames is not None:
        if options.attitude == "outside":
            raise ConfigurationError(
                f"--attitude outside: --frames {options.frames} show their own sky; allowed is one of them"
            )
        frames = RecordedFrames(options.frames, profile.detector.columns, profile.detector.rows)
    return RunPlan(profile, scenario, specification, speed, duration_s, frames, control)


def run_unit(options: RunOptions) -> None:
    """Run a unit as ``st-emulator run`` does, until its end, Ctrl-C or SIGTERM.

    Raises:
        ConfigurationError, LinkError, RecordedFrameError: something the user can mend.
    """
    console = Console(quiet=options.quiet, stderr=True, soft_wrap=True, highlight=False)
    plan = plan_of(options)
    profile, scenario, specification, live = plan.profile, plan.scenario, plan.specification, plan.live
    stop = StopSignal()
    with contextlib.ExitStack() as stack:
        stack.callback(stop.close)
        stack.enter_context(stop.installed())
        supervisor = None if options.supervisor is None else SupervisorSocket(options.supervisor)
        if supervisor is not None:
            stack.callback(supervisor.close)
        store, store_text = open_store(stack, options, profile, live)
        link = stack.enter_context(
            open_link(specification, "unit", profile.wire.baud, profile.name, profile.can.bitrate)
        )
        token = None if plan.control is None else token_for(stack, plan.control)
        journal = open_output(stack, options.journal, "--journal")
        truth = open_output(stack, options.truth, "--truth")
        try:
            with stop.interrupting(), console.status("loading catalogue and compiled kernels"):
                compile_apart(profile)
                warm_up(profile)
        except KeyboardInterrupt:
            console.print("stopped before power-on")
            return
        request = None
        if supervisor is not None:
            supervisor.ready(link=link.name, pid=os.getpid())
            request = supervisor.await_begin()
            if request is None:
                return
        if request is not None and (given := request.get("scenario")) is not None:
            now = {"start_utc": datetime.now(UTC).isoformat()}  # its OBC keeps the computer's time
            scenario = validate(Scenario, now | given, "--supervisor: scenario")
        elif options.scenario is None:
            scenario = scenario_of(options, live)  # power comes on now
        paced = plan.speed != math.inf and options.lockstep is None
        worker = FrameWorker() if paced else None
        if worker is not None:
            stack.callback(worker.close)

        def transmit(data: bytes, t_ns: int) -> int | None:
            written = link.write(data)
            return None if specification.kind == "none" else written  # without a link nothing is refused

        emulator = Emulator(
            profile,
            scenario,
            seed=options.seed,
            frames=plan.frames,
            hold=options.hold,
            store=store,
            transmit=transmit,
            journal=journal,
            truth=truth,
            submit=worker.submit if worker is not None else Lazy,
            pace_reception=specification.kind != "serial",
            baud=specification.baud,
            can=wiring_of(profile, specification, link, options.node),
            trajectory=SampledTrajectory() if options.attitude == "outside" else None,
        )
        if supervisor is not None and request is not None:
            supervisor.serve(Requests(Lockstep(emulator, link if live else None), steps=False), request)
        until_ns = plan.until_ns
        control = None
        if plan.control is not None and token is not None:
            served_link = link if live else None
            control = open_control(stack, plan.control, token, emulator, served_link, until_ns, _say)
        _announce(console, emulator, link, options, store_text, plan.duration_s, control)
        watch = _Watch(emulator, console)
        try:
            if control is not None and control.steps:
                run_lockstep(emulator, control.server, stop=stop, until_ns=until_ns, on_wait=watch)
            elif plan.speed == math.inf:
                assert until_ns is not None
                run_unpaced(emulator, stop=stop, until_ns=until_ns)
            else:
                run_paced(
                    emulator,
                    link,
                    stop=stop,
                    speed=plan.speed,
                    until_ns=until_ns,
                    on_wait=watch,
                    control=None if control is None else control.server,
                    beside=supervisor,
                )
        finally:
            emulator.close()
        counters, dialect = emulator.device.frame_counters, emulator.dialect
        console.print(
            f"stopped at {emulator.now_ns / NS_PER_S:.3f} s: {counters.frames_processed} frames, "
            f"{counters.frames_valid} valid, {dialect.messages_received} telecommands, "
            f"{dialect.messages_sent} telemetry packets"
        )


def wiring_of(
    profile: UnitProfile, specification: LinkSpecification, link: Link, node: int | None
) -> CanWiring | None:
    """How the unit is on a CAN bus; None on its serial line. Without a link it is where its dialect lives."""
    if specification.kind == "none" and dialect_of(profile).on_serial is None:
        return CanWiring()
    if specification.kind != "can":
        return None
    hardware = bool(getattr(link, "hardware", False))
    return CanWiring(specification.bitrate, specification.fd, node, hardware)


def _announce(
    console: Console,
    emulator: Emulator,
    link: Link,
    options: RunOptions,
    store_text: str,
    duration_s: float | None,
    control: Control | None,
) -> None:
    """Say what runs and where to find it, to a person and to a script."""
    profile = emulator.profile
    rate_hz = 1000 / profile.timing.frame_period_ms
    console.print(f"[bold]{escape(profile.unit.title)}[/]")
    console.print(
        f"link {escape(link.name)}, {emulator.dialect.where()}, frames at {rate_hz:g} Hz, "
        f"seed {emulator.seed}"
    )
    console.print(f"world: from {emulator.scenario.start_utc:%Y-%m-%dT%H:%M:%SZ}")
    console.print(f"non-volatile memory: {escape(store_text)}")
    end = "until stopped (Ctrl-C)" if duration_s is None else f"for {duration_s:g} s of virtual time"
    if control is not None:
        console.print(escape(control.told()))
    ready = {
        "unit": profile.name,
        "link": link.name,
        "seed": emulator.seed,
        "start_utc": f"{emulator.scenario.start_utc:%Y-%m-%dT%H:%M:%S.%fZ}",
        "control": None if control is None else control.ready(),
    }
    write_ready(options.json_path, ready)
    speed = "in lockstep with a client" if options.lockstep is not None else f"speed {options.speed}"
    console.print(f"running {end}, {escape(speed)}")
