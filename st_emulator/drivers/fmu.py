"""The unit in somebody else's simulator: a co-simulation slave of FMI 2.0, made with pythonfmu.

The master owns time, attitude and power. Over a step the attitude turns at the rate that was given at the
step's start, so that nothing is guessed: what the inputs say is the truth. The outputs are what has come out
of the unit's serial line by the end of the step: the attitude report as an on-board computer would have it.

``st-emulator export fmu`` writes an FMU whose script is a subclass of :class:`StarTrackerFmu`, with the unit
and the scenario as resources. The master's Python must have this package installed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from pythonfmu import (
    Boolean,
    Fmi2Causality,
    Fmi2Initial,
    Fmi2Slave,
    Fmi2Variability,
    Integer,
    Real,
)
from pythonfmu.default_experiment import DefaultExperiment
from pythonfmu.enums import Fmi2Status

from ..bench.emulator import Emulator
from ..bench.scenario import Scenario
from ..clock import NS_PER_S, NS_PER_US
from ..errors import ConfigurationError
from ..protocol.framing import FrameReceived, SlipDecoder, slip_encode
from ..protocol.pus.enumerations import EventId
from ..protocol.pus.packets import MAX_TELEMETRY_BYTES, CucTime, Malformed
from ..protocol.pus.registry import encode_telecommand, parse_telemetry
from ..units.profile import UnitProfile
from ..units.validation import validate
from ..wire.serial_line import BITS_PER_BYTE
from ..world import quaternion
from ..world.sampled import SampledTrajectory

RESOURCES: Final = {"unit": "unit.json", "scenario": "scenario.json"}
SAME_ATTITUDE: Final = 1e-12  # of a quaternion's components: rounding of the master's
_REPORT: Final = "attitude_report"

_INPUTS: Final = {
    "q_x": (0.0, "true attitude q_icrs_to_sensor, x, at the step's start"),
    "q_y": (0.0, "y"),
    "q_z": (0.0, "z"),
    "q_w": (1.0, "w, the scalar part"),
    "rate_x": (0.0, "true rate of the sensor to ICRS in sensor axes, x, rad/s; held over the step"),
    "rate_y": (0.0, "y, rad/s"),
    "rate_z": (0.0, "z, rad/s"),
    "sun_x": (0.0, "direction to the Sun, ICRS, x; heeded with sun_is_input"),
    "sun_y": (0.0, "y"),
    "sun_z": (1.0, "z"),
}
_REALS: Final = {
    "measured_q_x": "attitude of the last report, q_icrs_to_sensor, x",
    "measured_q_y": "y",
    "measured_q_z": "z",
    "measured_q_w": "w, the scalar part",
    "measured_rate_x": "rate of the last report, x, rad/s",
    "measured_rate_y": "y, rad/s",
    "measured_rate_z": "z, rad/s",
    "mid_exposure_s": "when the attitude of the last report held, simulation time, s",
    "latency_s": "from then until the last bit of the report had left the unit, s",
}
_INTEGERS: Final = {
    "mode": "of the last report; 255 while none has come since power-on",
    "reasons": "why its attitude is not valid, 0 when it is",
    "frame_index": "of the last report",
    "reports": "attitude reports so far",
}
NO_MODE: Final = 255


class StarTrackerFmu(Fmi2Slave):  # type: ignore[misc]  # pythonfmu has no types
    """One unit. Instances are made by the FMU's binary, with the folder of its resources."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.description = "A star tracker: true attitude in, its attitude reports out"
        self.default_experiment = DefaultExperiment(start_time=0.0, stop_time=10.0, step_size=0.05)
        for name, (start, description) in _INPUTS.items():
            setattr(self, name, start)
            self._register(Real(name, causality=Fmi2Causality.input, description=description))
        self.power = True
        self._register(
            Boolean(
                "power",
                causality=Fmi2Causality.input,
                variability=Fmi2Variability.discrete,
                description="whether the unit has it",
            )
        )
        self.seed = 1
        self.sun_is_input = False
        self.sets_time = True
        self._parameter(Integer, "seed", "of noise and random events")
        self._parameter(Boolean, "sun_is_input", "the Sun stands where sun_x, sun_y and sun_z say")
        self._parameter(
            Boolean,
            "sets_time",
            "the on-board time is set after each boot, as an on-board computer does; without it aberration "
            "is not corrected",
        )
        self.valid = False
        self._output(Boolean, "valid", "whether the attitude of the last report holds")
        for name, description in _REALS.items():
            setattr(self, name, 1.0 if name == "measured_q_w" else 0.0)
            self._output(Real, name, description)
        for name, description in _INTEGERS.items():
            setattr(self, name, NO_MODE if name == "mode" else 0)
            self._output(Integer, name, description)
        self.rate_valid = False
        self._output(Boolean, "rate_valid", "whether its rate holds, which it may without an attitude")
        self._emulator: Emulator | None = None
        self._truth = SampledTrajectory()
        self._decoder = SlipDecoder(MAX_TELEMETRY_BYTES)
        self._start_ns = 0

    def _register(self, variable: Any) -> None:
        self.register_variable(variable)

    def _parameter(self, kind: type, name: str, description: str) -> None:
        self._register(
            kind(
                name,
                causality=Fmi2Causality.parameter,
                variability=Fmi2Variability.fixed,
                initial=Fmi2Initial.exact,
                description=description,
            )
        )

    def _output(self, kind: type, name: str, description: str) -> None:
        discrete = {} if kind is Real else {"variability": Fmi2Variability.discrete}
        self._register(
            kind(
                name,
                causality=Fmi2Causality.output,
                initial=Fmi2Initial.exact,
                description=description,
                **discrete,
            )
        )

    # -- what the master calls

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        self._start_ns = round(start_time * NS_PER_S)

    def exit_initialization_mode(self) -> None:
        """Power comes on, or does not, with the inputs as they are now."""
        try:
            self._begin()
        except Exception as error:
            # The master sees only that it failed; what is said here is what it can log.
            self.log(f"{type(error).__name__}: {error}", Fmi2Status.fatal)
            raise

    def _begin(self) -> None:
        profile = _resource(UnitProfile, Path(self.resources) / RESOURCES["unit"])
        scenario = _resource(Scenario, Path(self.resources) / RESOURCES["scenario"])
        self._truth = SampledTrajectory()
        self._sample(0, self._attitude())
        self._emulator = Emulator(
            profile, scenario, seed=self.seed, transmit=self._transmitted, trajectory=self._truth
        )
        if not self.power:
            self._switch(self._emulator)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Let the unit live from ``current_time`` to ``current_time + step_size``, seconds."""
        try:
            self._step(round(current_time * NS_PER_S), round((current_time + step_size) * NS_PER_S))
        except (ConfigurationError, ValueError) as error:
            self.log(str(error), Fmi2Status.error)
            return False
        return True

    def terminate(self) -> None:
        """The run is over."""
        if self._emulator is not None:
            self._emulator.close()

    # -- inside

    def _step(self, start_ns: int, end_ns: int) -> None:
        emulator = self._emulator
        if emulator is None:
            raise ConfigurationError("a step before the initialisation is over")
        start_ns, end_ns = start_ns - self._start_ns, end_ns - self._start_ns
        if start_ns != emulator.now_ns or end_ns <= start_ns:
            raise ConfigurationError(
                f"a step from {start_ns / NS_PER_S:.9g} s to {end_ns / NS_PER_S:.9g} s; allowed are steps "
                f"that follow each other, the next from {emulator.now_ns / NS_PER_S:.9g} s"
            )
        self._switch(emulator)
        attitude = self._attitude()
        if start_ns and not _same(attitude, self._truth.q_icrs_to_sensor(start_ns)):
            self._sample(start_ns + 1, attitude)  # what the turn over the last step had not led to
        turn = quaternion.from_rotation_vector(
            np.array([self.rate_x, self.rate_y, self.rate_z]) * (end_ns - start_ns) / NS_PER_S
        )
        self._sample(end_ns, quaternion.multiply(turn, attitude))
        emulator.advance(end_ns)

    def _switch(self, emulator: Emulator) -> None:
        """As the input says; a fault of the scenario may keep power away although it is on."""
        emulator.power(bool(self.power))
        if not emulator.device.powered:
            self.valid, self.rate_valid, self.mode = False, False, NO_MODE

    def _attitude(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        q = np.array([self.q_x, self.q_y, self.q_z, self.q_w])
        if not np.all(np.isfinite(q)) or not np.linalg.norm(q) > 1e-6:
            raise ConfigurationError(
                f"q_x, q_y, q_z, q_w: found {q.tolist()}; allowed are finite numbers that are not all zero"
            )
        return quaternion.canonical(q / np.linalg.norm(q))

    def _sample(self, t_ns: int, attitude: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        sun = [self.sun_x, self.sun_y, self.sun_z] if self.sun_is_input else None
        self._truth.set_attitude(t_ns, attitude, sun_direction=sun)

    def _transmitted(self, data: bytes, t_ns: int) -> None:
        for event in self._decoder.receive(data, t_ns):
            if isinstance(event, FrameReceived):
                packet = parse_telemetry(event.data)
                if isinstance(packet, Malformed):
                    continue
                if packet.name == _REPORT:
                    self._take(packet.fields, t_ns)
                elif self.sets_time and packet.fields.get("event_id") == EventId.BOOT_COMPLETED:
                    assert self._emulator is not None
                    self._emulator.clock.after(0, self._set_time)

    def _set_time(self) -> None:
        """As the on-board computer: the time that will be when the last bit has arrived."""
        emulator = self._emulator
        assert emulator is not None
        wire = emulator.profile.wire

        def frame(at_ns: int) -> bytes:
            time = CucTime.from_ns(emulator.start_tai_ns + at_ns)
            packet = encode_telecommand(
                "set_time", {"time": time}, apid=wire.apid, sequence_count=0, source_id=wire.source_id, ack=0
            )
            return slip_encode(packet)

        line_ns = len(frame(emulator.now_ns)) * BITS_PER_BYTE * NS_PER_S // emulator.baud
        emulator.receive(frame(emulator.now_ns + line_ns))

    def _take(self, fields: dict[str, Any], t_ns: int) -> None:
        assert self._emulator is not None
        profile = self._emulator.profile
        mid_ns = (
            fields["frame_index"] * profile.frame_period_ns
            + (fields["exposure_us"] * NS_PER_US + profile.last_row_start_ns) // 2
            + self._emulator.device.powered_since_ns
        )
        for axis in "xyzw":
            setattr(self, f"measured_q_{axis}", fields[f"q_{axis}"])
        for axis in "xyz":
            setattr(self, f"measured_rate_{axis}", fields[f"rate_{axis}"])
        self.valid, self.rate_valid = bool(fields["valid"]), bool(fields["rate_valid"])
        self.mode, self.reasons = fields["mode"], fields["reasons"]
        self.frame_index = fields["frame_index"] & 0x7FFFFFFF  # an Integer of FMI has 32 bits and a sign
        self.mid_exposure_s = (mid_ns + self._start_ns) / NS_PER_S
        self.latency_s = (t_ns - mid_ns) / NS_PER_S
        self.reports += 1


def _same(a: Any, b: Any) -> bool:
    return float(np.max(np.abs(quaternion.canonical(a) - quaternion.canonical(b)))) <= SAME_ATTITUDE


def _resource(model: Any, path: Path) -> Any:
    return validate(model, json.loads(path.read_text(encoding="utf-8")), path.name)
