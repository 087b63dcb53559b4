"""The emulator: a device behind its dialect and wire, in its world, on one virtual clock. Sans-IO: bytes and
times in, bytes out.

Whoever drives it (the real-time pacer, a run as fast as possible, a test, an outside simulator) calls
:meth:`Emulator.advance` with a virtual time and :meth:`Emulator.receive` with bytes; transmitted bytes come
by callback at the virtual time at which their last bit has left the unit.
"""

from __future__ import annotations

import contextlib
import json
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..clock import NS_PER_S, VirtualClock
from ..device.imaging import FrameRecord, FrameSource, Lazy, Submit
from ..device.star_tracker import StarTracker
from ..device.store import Store, StoreContents, VolatileStore
from ..dialects.dialect import CanWire, Dialect, SerialWire
from ..dialects.registry import dialect_of, require_wire, settings_of
from ..errors import ConfigurationError
from ..faults.fault import Reach
from ..faults.faults import Faults
from ..faults.seams import SeamedSource, SeamedSpeaker, Seams
from ..faults.store import SeamedStore
from ..faults.supply import Supply
from ..firmware_model.image.frame import Frame
from ..protocol.can.frames import CanFrame
from ..tai import tai_ns_from_utc
from ..units.profile import UnitProfile
from ..wire.can.bus import Disturbance
from ..wire.can.controller import BusError
from ..wire.can.wiring import CanWiring
from ..world.recorded import RecordedFrames
from ..world.sampled import BeyondTruthError, SampledTrajectory, TruthSample
from ..world.scene import RenderedFrame, SceneRenderer
from ..world.trajectory import Trajectory
from .frame_times import FrameTimes
from .journal import JournalWriter, TextSink
from .scenario import Scenario
from .scenario_inputs import parameters_of, telecommands_of
from .star_tables import star_tables
from .trajectory_file import with_content
from .world_of import scene_of

# Samples of the truth this old are still there, for who wants to know what a frame in processing has seen.
TRUTH_KEPT_NS = 10 * NS_PER_S


class RecordedSource:
    """Recorded frames in front of the detector, each for ``hold`` exposures, over and over."""

    def __init__(self, frames: RecordedFrames, hold: int) -> None:
        self._frames = frames
        self._hold = hold
        self._exposures = 0

    def frame(self, frame_index: int, exposure_start_ns: int, exposure_ns: int) -> Any:
        frame = self._frames[self._exposures // self._hold % len(self._frames)]
        self._exposures += 1
        return frame


class LastExposed:
    """A source that remembers what it gave last, before faults."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self.frame_exposed: Frame | None = None

    def frame(self, frame_index: int, exposure_start_ns: int, exposure_ns: int) -> Frame | None:
        self.frame_exposed = self._source.frame(frame_index, exposure_start_ns, exposure_ns)
        return self.frame_exposed


@dataclass(frozen=True)
class Exposure:
    """One that lasts: ``frame`` is what the sky puts on the detector in it."""

    record: FrameRecord
    frame: Frame | None

    @property
    def end_ns(self) -> int:
        return self.record.exposure_end_ns


class Emulator:
    """One unit in its world.

    Args:
        profile: the unit.
        scenario: trajectory, sky, telecommands.
        seed: noise and random events; the scenario's when None.
        frames: recorded frames instead of the rendered sky.
        hold: so many exposures show the same recorded frame before the next takes its place.
        store: the unit's non-volatile memory; factory values when None.
        transmit: called with (bytes, virtual time) as they leave the unit: octets of the serial line, or the
            record of a CAN frame; returns how many the link took (None: all).
        journal, truth: open text files, or None.
        submit: how frames are computed (see :mod:`st_emulator.device.imaging`).
        trajectory: truth from outside in place of the scenario's trajectory. It is asked for an exposure when
            the exposure is over, never before.
        on_completed: called with each processed frame, its pixels and intermediates (pictures are made of
        it).
        baud: line rate; the unit's own when None.
        pace_reception: False when the link's bytes already took their time on a wire.
        can: the unit is on a CAN bus, wired like this; None: on its serial line.
        disturbance: what a test does to the CAN bus, before the run's faults.

    ``faults``: those of the scenario, and those that are put in live.
    """

    def __init__(
        self,
        profile: UnitProfile,
        scenario: Scenario | None = None,
        *,
        seed: int | None = None,
        frames: RecordedFrames | None = None,
        hold: int = 1,
        store: Store | None = None,
        transmit: Callable[[bytes, int], int | None] = lambda data, t_ns: None,
        journal: TextSink | None = None,
        truth: TextSink | None = None,
        submit: Submit = Lazy,
        pace_reception: bool = True,
        baud: int | None = None,
        can: CanWiring | None = None,
        disturbance: Disturbance | None = None,
        trajectory: Trajectory | None = None,
        on_completed: Callable[[FrameRecord], None] = lambda record: None,
    ) -> None:
        self.profile = profile
        self.scenario = with_content(scenario or Scenario())
        self.seed = self.scenario.seed if seed is None else seed
        self.baud = baud or profile.wire.baud
        self.can = can
        self._pace_reception = pace_reception
        self._disturbance = disturbance
        self.clock = VirtualClock()
        self.frame_times = FrameTimes()
        self._on_completed = on_completed
        self._came_in = (0, 0)  # time and actions until then of what came from outside last
        self._external_transmit = transmit
        self._hold = hold
        self._seams = Seams()
        self._store = SeamedStore(store if store is not None else VolatileStore(), self._seams)
        self._apply_scenario_parameters()
        self.start_tai_ns = tai_ns_from_utc(self.scenario.start_utc)
        self.scene: SceneRenderer | None = None
        self.trajectory = trajectory
        self._exposures: deque[Exposure] = deque()
        source: FrameSource
        if frames is not None:
            if trajectory is not None:
                raise ConfigurationError("recorded frames show their own sky; allowed is no trajectory")
            source = RecordedSource(frames, hold)
        else:
            source = self.scene = scene_of(profile, self.scenario, self.seed, self.start_tai_ns, trajectory)
        self._exposed = LastExposed(source)
        self.device = StarTracker(
            profile,
            self.clock,
            SeamedSource(self._exposed, self._seams),
            star_tables(profile),
            self._store,
            submit=submit if trajectory is None else Lazy,  # nothing asks before the exposure is over
            on_frame=self._frame_exposed,
            on_completed=self._frame_completed,
            seams=self._seams,
        )
        self._truth = truth
        self._journal: JournalWriter | None = None
        if journal is not None:
            self._journal = JournalWriter(journal, self._header(frames))
        if isinstance(trajectory, SampledTrajectory):
            for sample in trajectory.samples:
                self._truth_given(sample)
            trajectory.watch(self._truth_given, self._truth_needed_from_ns)
        self._telecommands = deque(telecommands_of(profile, self.scenario))
        self._sender = dialect_of(profile).sender(profile, settings_of(profile), can)
        self.dialect = self._dialect()
        self.device.speak_through(SeamedSpeaker(self.dialect, self._seams))
        self.faults = Faults(self._seams, self.seed, self._fault_told, self._fault_done)
        self._supply = Supply(self.device)
        self._switched_on = True
        self.faults.attach(self._reach(), self.scenario.faults, self.scenario.where)
        self._supply.begin()

    # -- driving it
    # ------------------------------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns

    def next_event_ns(self) -> int | None:
        """Virtual time of the next event."""
        due_ns = [self.clock.next_ns(), self._sender.next_ns()]
        if self._telecommands:
            due_ns.append(self._telecommands[0].at_ns)
        return min((max(t_ns, self.now_ns) for t_ns in due_ns if t_ns is not None), default=None)

    def advance(self, until_ns: int) -> None:
        """Let virtual time go on to ``until_ns``."""
        # The scenario's telecommands come in as an OBC's do, behind whatever else is due at their time: so a
        # replay of the journal, which holds them like any others, is the same run.
        while self._scenario_speaks():
            due_ns = self.next_event_ns()
            if due_ns is None or due_ns > until_ns:
                break
            self.clock.advance(due_ns)
            while self._telecommands and self._telecommands[0].at_ns <= due_ns:
                self._telecommands.popleft().send(self._sender)
            for data in self._sender.poll(due_ns):
                self.receive(data)
        self.clock.advance(until_ns)

    def _scenario_speaks(self) -> bool:
        return bool(self._telecommands) or self._sender.next_ns() is not None

    def receive(self, data: bytes) -> None:
        """The OBC put ``data`` on the line at the present virtual time."""
        if data:
            self._comes_in()
            if self._journal is not None:
                self._journal.write(self.clock.now_ns, "rx", data)
            self._arrive(data)

    def _comes_in(self) -> None:
        """Something comes from outside now. What came at one instant before anything else happened is one
        thing (frames compete for the bus); what happened in between is told to the journal.
        """
        before, self._came_in = self._came_in, (self.clock.now_ns, self.clock.actions)
        if self._journal is not None and before[0] == self._came_in[0] and before != self._came_in:
            self._journal.write_doing(self.clock.now_ns, "settle", None)

    def transmit_to(self, transmit: Callable[[bytes, int], int | None]) -> None:
        """What leaves the unit goes there from now on, as with the argument ``transmit``."""
        self._external_transmit = transmit

    def power(self, on: bool) -> None:
        """Switch the power at the present time; at the start it is on. Nothing where the switch is so. With
        it on, a fault may still keep power away."""
        if on == self._switched_on:
            return
        self._switched_on = on
        self._fault_done("power", "on" if on else "off")
        if on:
            self._supply.restore(self)
        else:
            self._supply.cut(self)

    def do(self, what: str, content: Any) -> None:
        """Do again what a journal says was done to the run: "inject" a fault, "clear" one, "power" is
        switched, "truth" gives a sample of it; "settle" runs what is due at this instant.

        Raises:
            ConfigurationError: it makes no sense here.
        """
        match what:
            case "settle":
                self.clock.advance(self.clock.now_ns)
            case "inject":
                self.faults.inject(content)
            case "clear":
                self.faults.clear(int(content))
            case "power" if content in ("on", "off"):
                self.power(content == "on")
            case "truth" if isinstance(self.trajectory, SampledTrajectory):
                try:
                    self.trajectory.add(TruthSample.of(content))
                except ValueError as error:
                    raise ConfigurationError(f"journal: truth: {error}") from error
            case "stand":
                raise ConfigurationError(
                    f"journal: at {self.clock.now_ns / NS_PER_S:.9f} s a fault of somebody's own was put in "
                    f"({content.get('kind')}): only the program that has it can replay this run"
                )
            case _:
                raise ConfigurationError(f"journal: {what}: nothing that is done to a run like this")

    def flush(self) -> None:
        """Write out what the journal and the truth file hold back."""
        if self._journal is not None:
            self._journal.flush()
        if self._truth is not None:
            self._truth.flush()

    def close(self) -> None:
        """Mark the end in the journal; the truth of exposures that still last is written where it is
        known."""
        if self.trajectory is None or isinstance(self.trajectory, SampledTrajectory):
            with contextlib.suppress(BeyondTruthError):
                while self._exposures:
                    self._fix_oldest_exposure()
        if self._journal is not None:
            self._journal.end(self.clock.now_ns)
        self.flush()

    # -- inside
    # ----------------------------------------------------------------------------------------------------

    def _dialect(self) -> Dialect:
        """The dialect on its wire.

        Raises:
            ConfigurationError: the language has no such wire.
        """
        definition, settings = dialect_of(self.profile), settings_of(self.profile)
        require_wire(self.profile, self.can is not None)
        if self.can is not None:
            assert definition.on_can is not None
            wire = CanWire(
                self.clock, self.can, self._transmitted, self._disturb, self._seams, self._seams.recovers
            )
            on_can: Dialect = definition.on_can(self.device, wire, settings)
            return on_can
        assert definition.on_serial is not None
        line = SerialWire(self.clock, self.baud, self._transmitted, self._pace_reception, self._seams)
        on_serial: Dialect = definition.on_serial(self.device, line, settings)
        return on_serial

    def _disturb(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        error = None if self._disturbance is None else self._disturbance(frame, own, now_ns)
        return self._seams.disturbance(frame, own, now_ns) if error is None else error

    def _arrive(self, data: bytes) -> None:
        """The link brought it: through the seam to the unit."""
        if self.can is not None:
            self._seams.records(data, False, self.dialect.arrive)
        elif octets := self._seams.octets(data, False):
            self.dialect.arrive(octets)

    def _transmitted(self, data: bytes) -> bool:
        """Through the seam to the link. Whether the link took it; what a CAN link does not take now is
        offered again.
        """
        if self.can is None:
            if octets := self._seams.octets(data, True):
                self._put_on_link(octets)
            return True
        taken: list[bool] = []
        self._seams.records(data, True, lambda record: taken.append(self._put_on_link(record)))
        return all(taken)  # what a fault keeps back has left the unit

    def _put_on_link(self, data: bytes) -> bool:
        taken = self._external_transmit(data, self.clock.now_ns)
        refused = self.can is not None and taken is not None and taken < len(data)
        if self._journal is not None:
            self._journal.write(self.clock.now_ns, "refused" if refused else "tx", data)
        if not refused:
            self._sender.take(data, self.clock.now_ns)
        return not refused

    def _frame_exposed(self, record: FrameRecord) -> None:
        if self._truth is not None or self.trajectory is not None:
            exposure = Exposure(record, self._exposed.frame_exposed)
            self._exposures.append(exposure)
            self.clock.at(exposure.end_ns, self._exposures_over)

    def _frame_completed(self, record: FrameRecord) -> None:
        self.frame_times.completed(record)
        self._on_completed(record)

    def _exposures_over(self) -> None:
        """What the frames have seen is fixed now, and goes into the truth file in the order of their starts.

        Raises:
            BeyondTruthError: the truth from outside does not reach so far; it can be done again when it does.
        """
        while self._exposures and self._exposures[0].end_ns <= self.now_ns:
            self._fix_oldest_exposure()

    def _fix_oldest_exposure(self) -> None:
        exposure = self._exposures[0]
        if isinstance(exposure.frame, RenderedFrame):
            if isinstance(self.trajectory, SampledTrajectory):
                self.trajectory.require(exposure.record.start_ns, exposure.end_ns)
            if self.trajectory is not None:
                _ = exposure.frame.light  # the samples of this time may be forgotten from now on
        line = None if self._truth is None else self._truth_line(exposure)
        self._exposures.popleft()
        if self._truth is not None and line is not None:
            self._truth.write(line + "\n")

    def _truth_line(self, exposure: Exposure) -> str:
        if isinstance(exposure.frame, RenderedFrame) and self.scene is not None:
            return self.scene.truth(exposure.frame).to_json()
        return json.dumps(
            {
                "frame_index": exposure.record.index,
                "exposure_mid_ns": exposure.record.mid_exposure_ns,
                "recorded": True,
                "file": Path(str(getattr(exposure.frame, "name", ""))).name,
            }
        )

    def _truth_given(self, sample: TruthSample) -> None:
        self._comes_in()
        if self._journal is not None:
            self._journal.write_doing(self.clock.now_ns, "truth", sample.as_dict())

    def _truth_needed_from_ns(self) -> int:
        oldest_ns = self._exposures[0].record.start_ns if self._exposures else self.now_ns
        return min(oldest_ns, self.now_ns - TRUTH_KEPT_NS)

    def _reach(self) -> Reach:
        return Reach(
            clock=self.clock,
            profile=self.profile,
            device=self.device,
            to_obc=self._put_on_link,
            to_unit=self.dialect.arrive,
            wire="serial" if self.can is None else "can",
            baud=self.baud,
            store=self._store,
            can=self.can,
            supply=self._supply,
        )

    def _fault_told(self, number: int, kind: str, what: str) -> None:
        if self._journal is not None:
            self._journal.note(self.clock.now_ns, f"fault {number} {kind} {what}")

    def _fault_done(self, what: str, content: Any) -> None:
        self._comes_in()
        if self._journal is not None:
            self._journal.write_doing(self.clock.now_ns, what, content)

    def _apply_scenario_parameters(self) -> None:
        """Parameters of the scenario are in the non-volatile memory at power-on."""
        if not self.scenario.parameters:
            return
        contents, _ = self._store.load()
        contents.parameters.update(parameters_of(self.scenario))
        self._store.save(StoreContents(contents.parameters, contents.boot_count))

    def _header(self, frames: RecordedFrames | None) -> dict[str, Any]:
        contents, fault = self._store.load()
        truth = {} if self.trajectory is None else {"truth": self._truth_kind()}
        return {
            **truth,
            "unit": self.profile.model_dump(mode="json"),
            "scenario": self.scenario.model_dump(mode="json", by_alias=True),
            "seed": self.seed,
            "baud": self.baud,
            "pace_reception": self._pace_reception,
            "can": None if self.can is None else asdict(self.can),
            "frames": None if frames is None else [str(Path(name).absolute()) for name in frames.names],
            "hold": self._hold,
            "store": {
                "parameters": contents.parameters,
                "boot_count": contents.boot_count,
                "fault": None if fault is None else int(fault),
            },
        }

    def _truth_kind(self) -> str:
        return "samples" if isinstance(self.trajectory, SampledTrajectory) else "not recorded"
