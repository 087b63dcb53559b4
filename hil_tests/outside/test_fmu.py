"""The unit as an FMU: fmpy, which is not ours, checks it and is its master."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from scipy.spatial.transform import Rotation

from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.units.profile import load_unit
from st_emulator.world.sampled import SampledTrajectory
from st_emulator.world.trajectory import quaternion_from_pointing

STEP_S = 0.05
START = quaternion_from_pointing(83.0, -3.0, 0.0)
ARCSEC = np.pi / 180 / 3600


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "roja1.fmu"
    run = subprocess.run(
        [sys.executable, "-m", "st_emulator", "export", "fmu", "roja1", "--out", path],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (run.returncode, run.stdout.strip()) == (0, str(path)), run.stderr
    return path


class Master:
    """An instance, by names."""

    def __init__(self, path: Path, name: str = "unit", **starts: Any) -> None:
        self.description = fmpy.read_model_description(str(path))
        self.variables = {one.name: one for one in self.description.modelVariables}
        self.slave = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(fmpy.extract(str(path))),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.set(**starts)
        self.slave.exitInitializationMode()
        self.steps = 0

    def set(self, **values: Any) -> None:
        for name, value in values.items():
            kind = self.variables[name].type
            getattr(self.slave, f"set{kind}")([self.variables[name].valueReference], [value])

    def get(self, name: str) -> Any:
        kind = self.variables[name].type
        return getattr(self.slave, f"get{kind}")([self.variables[name].valueReference])[0]

    def attitude(self) -> list[float]:
        return [self.get(f"measured_q_{axis}") for axis in "xyzw"]

    def step(self, count: int = 1) -> None:
        for _ in range(count):
            self.slave.doStep(self.steps * STEP_S, STEP_S)
            self.steps += 1

    def close(self) -> None:
        self.slave.terminate()
        self.slave.freeInstance()


def inputs(q: Any, rate: Any = (0.0, 0.0, 0.0)) -> dict[str, float]:
    named = zip(("q_x", "q_y", "q_z", "q_w", "rate_x", "rate_y", "rate_z"), [*q, *rate], strict=True)
    return {name: float(value) for name, value in named}


@pytest.fixture
def master(fmu: Path) -> Iterator[Master]:
    made = Master(fmu, **inputs(START))
    yield made
    made.close()


def test_fmpy_finds_nothing_wrong(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []


def turning(t_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(q_icrs_to_sensor, rate in sensor axes): a motion whose rate changes. For scipy the quaternion turns
    vectors of the sensor to ICRS."""
    rate = np.radians([0.1 * np.sin(0.3 * t_s), 0.05, 0.02])
    angle = np.radians([0.1 * (1 - np.cos(0.3 * t_s)) / 0.3, 0.05 * t_s, 0.02 * t_s])
    start = Rotation.from_quat(START)
    return (start * Rotation.from_rotvec(angle)).as_quat(), rate


def test_the_same_attitudes_as_in_one_process(fmu: Path) -> None:
    """The FMU's outputs are those of a unit that is fed the same truth, decoded by other code."""
    master = Master(fmu, seed=7, sets_time=False, **inputs(*turning(0.0)))
    seen = []
    for number in range(200):
        master.set(**inputs(*turning(number * STEP_S)))
        master.step()
        seen.append((*master.attitude(), master.get("valid"), master.get("frame_index"), master.get("mode")))
    latency_s = master.get("latency_s")
    master.close()

    truth = SampledTrajectory()
    octets: list[tuple[int, bytes]] = []
    emulator = None
    expected: list[Any] = []
    latest: Any = (0.0, 0.0, 0.0, 1.0, 0, 0, 255)
    end = None
    for number in range(200):
        start_ns, end_ns = round(number * STEP_S * 1e9), round((number + 1) * STEP_S * 1e9)
        q, rate = turning(number * STEP_S)
        truth.set_attitude(start_ns + (number > 0), q)
        end = (Rotation.from_quat(q) * Rotation.from_rotvec(rate * (end_ns - start_ns) * 1e-9)).as_quat()
        truth.set_attitude(end_ns, end)
        if emulator is None:
            emulator = Emulator(
                load_unit("roja1"),
                Scenario(parameters={"autonomous_start": 1}),
                seed=7,
                transmit=lambda data, t_ns: octets.append((t_ns, data)),
                trajectory=truth,
            )
        emulator.advance(end_ns)
        frames = list(wire.slip_frames(b"".join(data for _, data in octets)))
        reports = [one for one in map(wire.decode_telemetry, frames) if one["name"] == "attitude_report"]
        if reports:
            fields = reports[-1]["fields"]
            latest = (
                *(fields[f"q_{axis}"] for axis in "xyzw"),
                fields["valid"],
                fields["frame_index"],
                fields["mode"],
            )
        expected.append(latest)
    valid = [one for one in seen if one[4]]
    assert len({one[5] for one in valid}) > 30
    assert [one[4:] for one in seen] == [tuple(map(int, one[4:])) for one in expected]
    for one, other in zip(seen, expected, strict=True):
        # The truth of both differs by the rounding of a product.
        assert np.allclose(one[:4], other[:4], atol=2e-7)
    assert 0.05 < latency_s < 0.25


def test_the_attitude_is_the_true_one(fmu: Path) -> None:
    q, rate = START, np.radians([0.05, -0.1, 0.2])
    master = Master(fmu, **inputs(q, rate))
    errors = []
    frame = None
    for number in range(160):
        now = Rotation.from_quat(q) * Rotation.from_rotvec(rate * number * STEP_S)
        master.set(**inputs(now.as_quat(), rate))
        master.step()
        if master.get("valid") and master.get("frame_index") != frame:
            frame = master.get("frame_index")
            then = Rotation.from_quat(q) * Rotation.from_rotvec(rate * master.get("mid_exposure_s"))
            error = (then.inv() * Rotation.from_quat(master.attitude())).as_rotvec()
            errors.append(np.hypot(error[0], error[1]) / ARCSEC)
    rates = [master.get(f"measured_rate_{axis}") for axis in "xyz"]
    assert master.get("rate_valid")
    master.close()
    assert len(errors) > 20
    assert np.median(errors) < 2 * load_unit("roja1").requirements.cross_boresight_arcsec
    assert np.allclose(rates, rate, atol=10 * ARCSEC)


def test_power_is_an_input(master: Master) -> None:
    master.step(60)
    assert master.get("valid")
    assert master.get("mode") == 4
    reports = master.get("reports")
    master.set(power=False)
    master.step(20)
    assert (master.get("valid"), master.get("rate_valid"), master.get("mode")) == (0, 0, 255)
    assert master.get("reports") == reports
    master.set(power=True)
    master.step(60)
    assert master.get("valid")
    assert master.get("frame_index") < 12  # the grid runs from the new power-on


def test_the_sun_is_an_input(fmu: Path) -> None:
    boresight = Rotation.from_quat(START).apply([0.0, 0.0, 1.0])
    sun = {f"sun_{axis}": float(value) for axis, value in zip("xyz", boresight, strict=True)}
    master = Master(fmu, **inputs(START), **sun, sun_is_input=True)
    master.step(60)
    valid, reasons = master.get("valid"), master.get("reasons")
    master.close()
    assert not valid
    assert reasons


def test_two_instances_in_one_process(fmu: Path) -> None:
    many = [Master(fmu, f"unit {number}", **inputs(START)) for number in range(3)]
    for master in many:
        master.step(60)
    found = [(*master.attitude(), master.get("frame_index")) for master in many]
    for master in many:
        master.close()
    assert found[0] == found[1] == found[2]
    assert found[0][4] > 5


def test_a_step_that_does_not_follow_fails_and_the_next_one_goes_on(master: Master) -> None:
    master.step(3)
    with pytest.raises(FMICallException):
        master.slave.doStep(5.0, STEP_S)
    master.step(3)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nounit"], "nounit"),
        (["roja1", "--out", "x.zip"], "ends with .fmu"),
        (["roja1", "--out", "/dev/null/x.fmu"], "cannot be written"),
        (["roja1", "--scenario", "missing.toml"], "missing.toml"),
    ],
)
def test_what_cannot_be_written_is_told(arguments: list[str], said: str, tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-m", "st_emulator", "export", "fmu", *arguments],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
    )
    assert run.returncode == 2
    assert said in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
