"""A closed loop: Basilisk owns the spacecraft and points it, a star tracker of ours tells it where it looks.

    python examples/basilisk_closed_loop.py [--json FILE] [--plot FILE]

Basilisk (hanspeterschaub.info/basilisk) integrates a rigid body and runs its own flight software: attitude
error and MRP feedback control. In lockstep with it runs a unit on its serial line: it is told the true
attitude, and what it has sent is read each quarter of a second as an on-board computer reads it: SLIP frames,
packets, attitude reports. The controller knows nothing else. The body begins at rest, 30 degrees off its
target; it ends as well pointed as the unit can tell.

Needs the package bsk: pip install 'st-emulator[basilisk]'.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import itertools
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from st_emulator import protocol
from st_emulator.clock import NS_PER_S
from st_emulator.drivers.lockstep import Lockstep
from st_emulator.errors import ConfigurationError
from st_emulator.report import all_hold, check, show_checks, show_figures, write_json
from st_emulator.units.profile import UnitProfile, load_unit
from st_emulator.world import quaternion

ARCSEC = math.pi / 180 / 3600
CONTROL_NS = 250_000_000  # a control step, as long as a frame of the unit
DYNAMICS_NS = 50_000_000  # a step of the integrator: the truth is told as often
TARGET = quaternion.quaternion_from_pointing(ra_deg=83.0, dec_deg=-3.0, roll_deg=0.0)
AXIS_OFF = np.array([1.0, 2.0, 2.0]) / 3.0  # of the turn from the target at the start, body axes
BODY_TO_SENSOR = quaternion.canonical([0.5, 0.5, 0.5, 0.5])  # the boresight is the body's x axis
INERTIA_KG_M2 = np.diag([0.9, 1.0, 0.95])
RATE_USED = 0.9  # of the largest rate at which the unit tracks
FORGOTTEN_NS = 2 * NS_PER_S  # without a valid attitude for so long the controller lets go
JUDGED_S = 60.0  # at the end


def mrp(q: np.ndarray) -> list[float]:
    """Modified Rodrigues parameters of a quaternion [x, y, z, w]: both turn vectors into the same frame."""
    x, y, z, w = quaternion.canonical(q)
    return [x / (1.0 + w), y / (1.0 + w), z / (1.0 + w)]


def quaternion_of(sigma: Any) -> np.ndarray:
    """The inverse of :func:`mrp`."""
    s = np.asarray(sigma, dtype=np.float64)
    square = float(s @ s)
    return quaternion.canonical([*(2.0 * s / (1.0 + square)), (1.0 - square) / (1.0 + square)])


class Spacecraft:
    """Basilisk's side: a rigid body, its controller, and a message that stands for the navigation."""

    def __init__(self, off_deg: float, largest_rate_deg_s: float) -> None:
        from Basilisk.architecture import messaging
        from Basilisk.fswAlgorithms import attTrackingError, inertial3D, mrpFeedback
        from Basilisk.simulation import extForceTorque, spacecraft
        from Basilisk.utilities import SimulationBaseClass

        self._messaging = messaging
        # Critically damped from rest, the rate is at most off x bandwidth / e.
        self._bandwidth_rad_s = largest_rate_deg_s * math.e / off_deg
        self._simulation = simulation = SimulationBaseClass.SimBaseClass()
        process = simulation.CreateNewProcess("spacecraft")
        process.addTask(simulation.CreateNewTask("dynamics", DYNAMICS_NS))
        process.addTask(simulation.CreateNewTask("control", CONTROL_NS))
        target = quaternion.multiply(quaternion.conjugate(BODY_TO_SENSOR), TARGET)
        off = quaternion.multiply(quaternion.from_rotation_vector(np.radians(off_deg) * AXIS_OFF), target)

        self._body = body = spacecraft.Spacecraft()
        body.hub.mHub = 12.0
        body.hub.IHubPntBc_B = INERTIA_KG_M2.tolist()
        body.hub.sigma_BNInit = [[value] for value in mrp(off)]
        body.hub.omega_BN_BInit = [[0.0], [0.0], [0.0]]
        torque = extForceTorque.ExtForceTorque()
        body.addDynamicEffector(torque)
        simulation.AddModelToTask("dynamics", body)
        simulation.AddModelToTask("dynamics", torque)

        reference = inertial3D.inertial3D()
        reference.sigma_R0N = mrp(target)
        self._navigation = messaging.NavAttMsg()
        error = attTrackingError.attTrackingError()
        error.attNavInMsg.subscribeTo(self._navigation)
        error.attRefInMsg.subscribeTo(reference.attRefOutMsg)
        self._control = control = mrpFeedback.mrpFeedback()
        self._inertia = float(np.trace(INERTIA_KG_M2)) / 3.0
        control.Ki = -1.0
        configuration = messaging.VehicleConfigMsgPayload(ISCPntB_B=INERTIA_KG_M2.flatten().tolist())
        self._configuration = messaging.VehicleConfigMsg().write(configuration)
        control.guidInMsg.subscribeTo(error.attGuidOutMsg)
        control.vehConfigInMsg.subscribeTo(self._configuration)
        torque.cmdTorqueInMsg.subscribeTo(control.cmdTorqueOutMsg)
        for model in (reference, error, control):
            simulation.AddModelToTask("control", model)
        self._kept = (torque, reference, error)  # Basilisk holds no references to them
        self.tell(None)
        simulation.InitializeSimulation()

    def tell(self, navigation: tuple[np.ndarray, np.ndarray] | None) -> None:
        """What the controller knows from now on: attitude of the body and its rate (rad/s); None: nothing."""
        payload = self._messaging.NavAttMsgPayload()
        if navigation is None:
            self._control.K = self._control.P = 0.0
        else:
            # A small angle is four times the MRP: I a'' = -K a / 4 - P a'.
            self._control.K = 4.0 * self._inertia * self._bandwidth_rad_s**2
            self._control.P = 2.0 * self._inertia * self._bandwidth_rad_s
            payload.sigma_BN = mrp(navigation[0])
            payload.omega_BN_B = navigation[1].tolist()
        self._navigation.write(payload, self._simulation.TotalSim.CurrentNanos)

    def run_to(self, t_ns: int) -> None:
        """Integrate, and control."""
        self._simulation.ConfigureStopTime(t_ns)
        self._simulation.ExecuteSimulation()

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """(true attitude of the sensor, q_icrs_to_sensor; its true rate in sensor axes, rad/s)."""
        state = self._body.scStateOutMsg.read()
        attitude = quaternion.multiply(BODY_TO_SENSOR, quaternion_of(state.sigma_BN))
        return attitude, quaternion.rotate(BODY_TO_SENSOR, np.array(state.omega_BN_B))


class OnBoardComputer:
    """The other end of the unit's line: sets the time, commands, reads reports. It knows bytes alone."""

    def __init__(self, profile: UnitProfile, unit: Lockstep) -> None:
        self._profile = profile
        self._unit = unit
        self._decoder = protocol.SlipDecoder(protocol.MAX_TELEMETRY_BYTES)
        self._count = 0
        self.digest = hashlib.sha256()
        self.reports: list[dict[str, Any]] = []
        self.crc_errors = 0
        self._time_offset_ns: int | None = None  # from virtual time to what the unit calls it

    def listen(self) -> None:
        """Read what has come."""
        for t_ns, data in self._unit.take_groups():
            self.digest.update(t_ns.to_bytes(8, "big") + data)
            for event in self._decoder.receive(data, t_ns):
                if isinstance(event, protocol.FrameReceived):
                    self._take(protocol.parse_telemetry(event.data))

    def _take(self, packet: protocol.Telemetry | protocol.Malformed) -> None:
        if isinstance(packet, protocol.Malformed):
            self.crc_errors += 1
        elif packet.name == "attitude_report":
            self.reports.append(packet.fields)
        elif packet.fields.get("event_id") == protocol.EventId.BOOT_COMPLETED:
            self._set_time()
            self._send("function", {"function_id": protocol.FunctionId.START_ACQUISITION})

    def _set_time(self) -> None:
        """To the time at which the last bit of the telecommand will have come; ten bits an octet."""
        self._time_offset_ns = offset_ns = self._unit.emulator.start_tai_ns
        now_ns = self._unit.now_ns
        octets = len(self._frame("set_time", {"time": protocol.CucTime.from_ns(offset_ns + now_ns)}))
        line_ns = octets * 10 * NS_PER_S // self._profile.wire.baud
        self._send("set_time", {"time": protocol.CucTime.from_ns(offset_ns + now_ns + line_ns)})

    def _frame(self, name: str, fields: dict[str, Any]) -> bytes:
        packet = protocol.encode_telecommand(
            name, fields, apid=self._profile.apid, sequence_count=self._count, ack=0
        )
        return protocol.slip_encode(packet)

    def _send(self, name: str, fields: dict[str, Any]) -> None:
        self._unit.receive(self._frame(name, fields))
        self._count += 1

    def navigation(self, now_ns: int) -> tuple[np.ndarray, np.ndarray] | None:
        """(attitude of the body, its rate in body axes) now, by the last valid report; None: none, or old."""
        report = next((one for one in reversed(self.reports) if one["valid"] and one["rate_valid"]), None)
        if report is None or self._time_offset_ns is None or not report["time_status"]:
            return None
        age_ns = now_ns + self._time_offset_ns - report["mid_exposure_time"].to_ns()
        if age_ns > FORGOTTEN_NS:
            return None
        rate = np.array([report[f"rate_{axis}"] for axis in "xyz"])
        measured = np.array([report[f"q_{axis}"] for axis in "xyzw"])
        turn = quaternion.from_rotation_vector(rate * age_ns / NS_PER_S)
        sensor_to_body = quaternion.conjugate(BODY_TO_SENSOR)
        attitude = quaternion.multiply(sensor_to_body, quaternion.multiply(turn, measured))
        return attitude, quaternion.rotate(sensor_to_body, rate)


@dataclass
class History:
    """Each control step: seconds, pointing error about x and y and the boresight (arcsec), rate (deg/s),
    whether the controller had an attitude."""

    t_s: list[float] = field(default_factory=list)
    error_arcsec: list[np.ndarray] = field(default_factory=list)
    rate_deg_s: list[float] = field(default_factory=list)
    knows: list[bool] = field(default_factory=list)


def fly(
    profile: UnitProfile, seconds: float, off_deg: float, seed: int, console: Console
) -> tuple[History, OnBoardComputer]:
    """The whole flight."""
    craft = Spacecraft(off_deg, RATE_USED * profile.tracking.rate_deg_s)
    unit = Lockstep.of(profile, seed=seed)
    computer = OnBoardComputer(profile, unit)
    history = History()
    unit.set_attitude(0, *craft.state())
    steps = range(round(seconds * NS_PER_S / CONTROL_NS))
    for step in track(steps, "flying", console=console, transient=True):
        start_ns = step * CONTROL_NS
        for t_ns in range(start_ns + DYNAMICS_NS, start_ns + CONTROL_NS + 1, DYNAMICS_NS):
            craft.run_to(t_ns)
            unit.set_attitude(t_ns, *craft.state())
        unit.step_to(start_ns + CONTROL_NS)
        computer.listen()
        navigation = computer.navigation(unit.now_ns)
        craft.tell(navigation)
        attitude, rate = craft.state()
        history.t_s.append(unit.now_ns / NS_PER_S)
        history.error_arcsec.append(quaternion.error_rotation_vector(attitude, TARGET) / ARCSEC)
        history.rate_deg_s.append(math.degrees(float(np.linalg.norm(rate))))
        history.knows.append(navigation is not None)
    unit.emulator.close()
    return history, computer


def plot(history: History, profile: UnitProfile, path: Path) -> None:
    """Error, rate and what the controller knew over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    errors = np.array(history.error_arcsec)
    above.semilogy(history.t_s, np.hypot(errors[:, 0], errors[:, 1]), label="boresight to target", color="C0")
    above.semilogy(history.t_s, np.abs(errors[:, 2]), label="about the boresight", color="C1", alpha=0.7)
    limit = profile.requirements.cross_boresight_arcsec
    if limit:
        above.axhline(
            limit, color="black", linestyle="--", label=f"the unit's accuracy, {limit:g} arcsec an axis"
        )
    above.set_ylabel("true error, arcsec")
    above.legend(loc="upper right")
    above.set_title(f"Basilisk points a spacecraft by the telemetry of {profile.name}")
    above.grid(alpha=0.3)
    below.plot(history.t_s, history.rate_deg_s, color="C2")
    below.axhline(
        profile.tracking.rate_deg_s, color="black", linestyle=":", label="the unit tracks up to here"
    )
    below.set_ylabel("true rate, deg/s")
    below.set_xlabel("virtual time, s")
    below.legend(loc="center right")
    below.grid(alpha=0.3)
    for begin, end in without_attitude(history):
        for axes in (above, below):
            axes.axvspan(begin, end, color="C3", alpha=0.15, linewidth=0)
    figure.savefig(path, dpi=120)


def without_attitude(history: History) -> list[tuple[float, float]]:
    """Where the controller knew no attitude."""
    spans, start = [], 0.0
    for knows, group in itertools.groupby(
        zip(history.knows, history.t_s, strict=True), key=lambda one: one[0]
    ):
        end = list(group)[-1][1]
        if not knows:
            spans.append((start, end))
        start = end
    return spans


def figures_of(history: History, computer: OnBoardComputer) -> dict[str, Any]:
    errors = np.array(history.error_arcsec)
    last = np.array(history.t_s) > history.t_s[-1] - JUDGED_S
    across, about = errors[last][:, :2], errors[last][:, 2]
    return {
        "seconds": history.t_s[-1],
        "start_off_deg": float(np.linalg.norm(errors[0])) * ARCSEC * 180 / math.pi,
        "largest_rate_deg_s": max(history.rate_deg_s),
        "first_attitude_s": next(
            (t for t, knows in zip(history.t_s, history.knows, strict=True) if knows), None
        ),
        "reports": len(computer.reports),
        "valid_reports": sum(one["valid"] for one in computer.reports),
        "crc_errors": computer.crc_errors,
        "cross_boresight_rms_arcsec": float(np.sqrt(np.mean(across**2))),
        "cross_boresight_worst_arcsec": float(np.max(np.hypot(across[:, 0], across[:, 1]))),
        "about_boresight_rms_arcsec": float(np.sqrt(np.mean(about**2))),
        "telemetry_sha256": computer.digest.hexdigest(),
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--unit", default="roja1", help="a shipped unit or the path of a unit file (roja1)")
    parser.add_argument("--seconds", type=float, default=480.0, help="of the flight (480)")
    parser.add_argument("--off-deg", type=float, default=30.0, help="from the target at the start (30)")
    parser.add_argument("--seed", type=int, default=1, help="of the unit's noise (1)")
    parser.add_argument("--json", metavar="FILE", help="write figures and checks (- for standard output)")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw error and rate over time (PNG, SVG)")
    options = parser.parse_args(arguments)
    console = Console(stderr=options.json == "-")
    if importlib.util.find_spec("Basilisk") is None:
        print(
            "the package bsk is missing; it comes with pip install 'st-emulator[basilisk]'", file=sys.stderr
        )
        return 2
    if not JUDGED_S < options.seconds <= 1e5 or not 0 < options.off_deg <= 175:
        print(f"allowed are --seconds over {JUDGED_S:g} and --off-deg over 0 to 175", file=sys.stderr)
        return 2
    try:
        profile = load_unit(options.unit)
    except ConfigurationError as error:
        print(error, file=sys.stderr)
        return 2
    history, computer = fly(profile, options.seconds, options.off_deg, options.seed, console)
    figures = figures_of(history, computer)
    limit = profile.requirements.cross_boresight_arcsec or profile.pixel_arcsec
    checks = [
        check(
            "cross-boresight error, rms of the last minute",
            figures["cross_boresight_rms_arcsec"],
            "<=",
            limit,
            "arcsec",
        ),
        check("frames with a wrong check sum", computer.crc_errors, "==", 0, ""),
    ]
    show_figures(console, f"Basilisk and {profile.name}", figures)
    show_checks(console, checks)
    if options.plot is not None:
        plot(history, profile, options.plot)
        console.print(f"plot: {options.plot}")
    write_json(options.json, figures, checks)
    return 0 if all_hold(checks) else 1


if __name__ == "__main__":
    sys.exit(main())
