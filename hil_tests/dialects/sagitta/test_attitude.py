"""Solutions against the truth, computed with numpy alone; validation, mounting, blinding, overrun."""

from __future__ import annotations

import math
import struct

import erfa
import numpy as np
import pytest

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import START_UNIX_US, Bench, line_ns, make, unit
from hil_tests.dialects.sagitta.client import SET, SOLUTION
from st_emulator.bench.scenario import ConstantRateTrajectory, InertialTrajectory, Scenario

ARCSEC = math.degrees(1) * 3600
#: The frame with the boresight on +X: x is the device's z, y its x, z its y.
BORESIGHT_X = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def matrix(w: float, x: float, y: float, z: float) -> np.ndarray:
    """C = (w^2 - v.v) I + 2 v v' - 2 w [v x]: inertial components to the unit's."""
    v = np.array([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) - 2 * w * cross


def truth(bench: Bench, t_ns: int) -> np.ndarray:
    """Inertial to the device's frame."""
    assert bench.emulator.scene is not None
    x, y, z, w = bench.emulator.scene.trajectory.q_icrs_to_sensor(t_ns)
    return matrix(w, x, y, z)


def errors_arcsec(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Small turn between two attitudes, axes of the frame of both."""
    turn = found @ true.T
    return np.array([turn[1, 2] - turn[2, 1], turn[2, 0] - turn[0, 2], turn[0, 1] - turn[1, 0]]) / 2 * ARCSEC


def valid_solutions(bench: Bench, count: int) -> list[client.Frame]:
    """The next valid solutions that are told."""
    bench.frames.clear()

    def found() -> list[client.Frame]:
        return [f for f in bench.subscribed(SOLUTION) if client.solution(f)["valid"]]

    bench.run_until(lambda: len(found()) >= count)
    return found()


@pytest.mark.parametrize("name", ["roja1", "zy3"])
def test_within_the_units_accuracy(name: str) -> None:
    bench = make(name).boot()
    bench.set_time()
    bench.subscribe(SOLUTION)
    wanted = BORESIGHT_X @ truth(bench, 0)  # at rest to the stars
    errors = []
    for frame in valid_solutions(bench, 12):
        q = client.solution(frame)["q"]
        assert abs(math.hypot(*q) - 1) < 1e-6
        assert q[0] >= 0
        errors.append(errors_arcsec(matrix(*q), wanted))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    limit = bench.emulator.profile.requirements.cross_boresight_arcsec
    assert limit is not None
    assert rms[1] <= limit
    assert rms[2] <= limit
    assert rms[0] <= 30 * limit  # about the boresight


@pytest.mark.parametrize("name", ["roja1", "zy3"])
def test_turning_at_the_time_of_mid_exposure(name: str) -> None:
    scenario = Scenario(
        trajectory=ConstantRateTrajectory(
            kind="constant_rate", ra_deg=83.0, dec_deg=-3.0, rate_deg_s=(0.1, -0.05, 0.2)
        )
    )
    bench = make(name, scenario, solution_time="mid_exposure").boot()
    bench.set_time()
    bench.subscribe(SOLUTION)
    for frame in valid_solutions(bench, 8):
        mid_ns = (frame.time_us - START_UNIX_US) * 1000
        assert 0 < frame.t_ns - mid_ns < 400_000_000
        error = errors_arcsec(matrix(*client.solution(frame)["q"]), BORESIGHT_X @ truth(bench, mid_ns))
        assert np.hypot(error[1], error[2]) < 5
        assert abs(error[0]) < 60
        # 0.1 s beside it the attitude is another by far
        late = errors_arcsec(matrix(*client.solution(frame)["q"]), BORESIGHT_X @ truth(bench, mid_ns + 10**8))
        assert np.linalg.norm(late) > 70


def test_boresight_on_z() -> None:
    bench = make(boresight="+z").boot()
    bench.set_time()
    bench.subscribe(SOLUTION)
    frame = valid_solutions(bench, 1)[0]
    error = errors_arcsec(matrix(*client.solution(frame)["q"]), truth(bench, 0))
    assert np.hypot(error[0], error[1]) < 3
    assert abs(error[2]) < 60


def test_the_drivers_body_frame() -> None:
    """q_i2b = q_i2c * q_c2b by Hamilton's product is the body attitude by matrices."""
    bench = make().boot()
    bench.set_time()
    bench.subscribe(SOLUTION)
    w, x, y, z = client.solution(valid_solutions(bench, 1)[0])["q"]
    cw, cx, cy, cz = 0.5, 0.5, -0.5, 0.5
    product = (
        w * cw - x * cx - y * cy - z * cz,
        w * cx + x * cw + y * cz - z * cy,
        w * cy - x * cz + y * cw + z * cx,
        w * cz + x * cy - y * cx + z * cw,
    )
    body = matrix(cw, cx, cy, cz) @ BORESIGHT_X @ truth(bench, 0)
    assert np.abs(errors_arcsec(matrix(*product), body)).max() < 60


def test_mounting_turns_the_solution() -> None:
    bench = make().boot()
    bench.set_time()
    bench.subscribe(SOLUTION)
    half = math.radians(30) / 2
    mounting = (math.cos(half), 0.0, math.sin(half), 0.0)
    assert bench.status(SET, 6, struct.pack("<4f", *mounting)) == 0
    q = client.solution(valid_solutions(bench, 1)[0])["q"]
    wanted = matrix(*mounting) @ BORESIGHT_X @ truth(bench, 0)
    assert np.abs(errors_arcsec(matrix(*q), wanted)).max() < 60


def test_mounting_is_gone_with_a_start() -> None:
    bench = make().boot()
    assert bench.status(SET, 6, struct.pack("<4f", 0.5, 0.5, 0.5, 0.5)) == 0
    bench.device.power_off()
    bench.device.power_on()
    bench.boot()
    bench.subscribe(SOLUTION)
    q = client.solution(valid_solutions(bench, 1)[0])["q"]
    assert np.abs(errors_arcsec(matrix(*q), BORESIGHT_X @ truth(bench, 0))).max() < 60


def test_modes_counts_and_strategies_of_an_acquisition() -> None:
    bench = make().boot()
    bench.subscribe(SOLUTION)
    bench.run_until(lambda: len(bench.subscribed(SOLUTION)) >= 8)
    told = [client.solution(frame) for frame in bench.subscribed(SOLUTION)]
    assert [one["stable"] for one in told] == list(range(1, len(told) + 1))
    assert [one["valid"] for one in told] == [0, 0, 0, 0] + [1] * (len(told) - 4)  # validation: 5 in a row
    assert [one["mode"] for one in told] == [1] + [0] * (len(told) - 1)
    assert [one["strategy"] for one in told] == [4] + [5] * (len(told) - 1)
    first, last = told[0], told[-1]
    assert first["track_q"] == (0, 0, 0, 0)
    assert first["lisa_q"] == first["q"]
    assert first["lisa_close"] == first["matched"]
    assert first["lisa_fraction_close"] == pytest.approx(first["matched"] / first["centroided"], rel=1e-6)
    assert last["track_q"] == last["q"]
    assert last["lisa_q"] == first["q"]
    assert 0.5 < last["track_confidence"] <= 1.0
    assert last["matched"] >= 6


def test_a_solution_leaves_when_the_frames_result_counts() -> None:
    due_ns: list[int] = []
    bench = Bench(unit(), on_completed=lambda record: due_ns.append(record.due_ns or 0)).boot()
    bench.subscribe(SOLUTION)
    bench.run(2000)
    begun_ns = [frame.t_ns - line_ns(frame.line_bytes) for frame in bench.subscribed(SOLUTION)]
    assert len(begun_ns) >= 6
    assert begun_ns == due_ns[-len(begun_ns) :]


@pytest.mark.parametrize(
    ("validation", "settings", "wanted"),
    [
        ((2, 0.5, 0.005, 6), {}, [0, 1, 1, 1]),
        ((1, 0.5, 0.005, 255), {}, [0, 0, 0, 0]),
        ((1, 0.5, 1.5, 6), {}, [1, 0, 0, 0]),  # no confidence is asked of LISA
        ((1, 0.0, 0.005, 6), {}, [1, 1, 1, 1]),
        ((2, 0.0, 0.005, 6), {}, [0, 0, 0, 0]),
        ((200, 0.0, 2.0, 255), {"validation": False}, [1, 1, 1, 1]),
    ],
)
def test_validation(validation: tuple, settings: dict, wanted: list[int]) -> None:
    bench = make(**settings).boot()
    bench.put(client.request(SET, 15, struct.pack("<BffB", *validation)))
    bench.put(client.request(SET, 18, client.subscription(SOLUTION)))
    bench.run_until(lambda: len(bench.subscribed(SOLUTION)) >= len(wanted))
    assert [client.solution(frame)["valid"] for frame in bench.subscribed(SOLUTION)][:4] == wanted


def sun_deg(jd_tt: float) -> tuple[float, float]:
    """Right ascension and declination of the Sun, by ERFA's epv00."""
    heliocentric, _ = erfa.epv00(jd_tt, 0.0)
    x, y, z = -np.asarray(heliocentric["p"])
    return float(np.degrees(np.arctan2(y, x)) % 360), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


@pytest.mark.parametrize("name", ["roja1", "zy3"])
def test_blinded_by_the_sun(name: str) -> None:
    ra_deg, dec_deg = sun_deg(2461055.5)  # 2026-01-15
    profile = unit(name)
    inside = profile.exclusion.sun_deg * 0.75
    scenario = Scenario(trajectory=InertialTrajectory(ra_deg=ra_deg, dec_deg=dec_deg + inside))
    bench = Bench(profile, scenario).boot()
    bench.subscribe(SOLUTION)
    bench.run(1500)
    told = [client.solution(frame) for frame in bench.subscribed(SOLUTION)]
    assert len(told) >= 4
    assert {(one["valid"], one["stable"], one["mode"], one["strategy"]) for one in told} == {(0, 0, 1, 8)}
    assert {one["q"] for one in told} == {(0, 0, 0, 0)}  # there never was one


def test_overrun_loses_frames_and_says_so() -> None:
    bench = Bench(unit(), Scenario(parameters={"clock_hz": 24_000_000})).boot()
    bench.subscribe(SOLUTION)
    bench.run(6000)
    assert bench.device.frame_counters.frames_dropped > 3
    told = [client.solution(frame) for frame in bench.subscribed(SOLUTION)]
    dropped = [one for one in told if one["centroided"] == 0]
    assert len(dropped) > 3
    assert all(one["valid"] == 0 and one["stable"] == 0 for one in dropped)
    # Tracking loses each second frame and goes on: strategy 6 for it and for the first good one after it.
    tracked = [one for one in told if one["mode"] == 0]
    assert {one["stable"] for one in tracked} == {0, 1}
    assert {one["strategy"] for one in tracked} == {6}
    first = next(one for one in told if one["stable"])
    assert (first["mode"], first["strategy"]) == (1, 4)


@pytest.mark.parametrize("held", [True, False])
def test_the_last_quaternion_is_held_or_not(held: bool) -> None:
    # It turns away towards the Sun after two seconds.
    ra_deg, dec_deg = sun_deg(2461055.5)
    from st_emulator.bench.scenario import SlewTrajectory

    scenario = Scenario(
        trajectory=SlewTrajectory(
            kind="slew",
            ra_deg=ra_deg,
            dec_deg=dec_deg + 60,
            segments=[
                {"kind": "hold", "duration_s": 3.0},
                {"kind": "slew_to", "duration_s": 2.0, "ra_deg": ra_deg, "dec_deg": dec_deg + 10},
            ],
        )
    )
    bench = make("roja1", scenario, hold_quaternion=held).boot()
    bench.subscribe(SOLUTION)
    bench.run(5500)
    told = [client.solution(frame) for frame in bench.subscribed(SOLUTION)]
    assert any(one["valid"] for one in told)
    solved = [one["q"] for one in told if one["stable"]]
    assert (told[-1]["valid"], told[-1]["stable"]) == (0, 0)
    assert told[-1]["q"] == (solved[-1] if held else (0, 0, 0, 0))
    # tracking goes on over some frames, then it is given up, then LISA finds nothing
    after = [one["strategy"] for one in told][len(solved) :]
    assert after[-1] == 8
    assert set(after) == {6, 7, 8}
    assert after == sorted(after)
