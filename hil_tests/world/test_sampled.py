"""Sampled truth against motions that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from st_emulator.world import orbit, trajectory
from st_emulator.world.bodies import ObserverState
from st_emulator.world.sampled import BeyondTruthError, SampledTrajectory, TruthSample
from st_emulator.world.trajectory import Trajectory, TrajectoryWithSun

ARCSEC = np.pi / 180 / 3600
S = 1_000_000_000


def coning(t: float) -> tuple[np.ndarray, np.ndarray]:
    """(attitude matrix, rate in sensor axes) of a top: turns by 0.7 t about z, tilted by 0.4 sin t about x.

    ``A = Z(0.7 t) X(0.4 sin t)``, passive; its rate is ``0.7 z + Z (0.4 cos t) x``.
    """
    passive_z = Rotation.from_rotvec([0, 0, -0.7 * t]).as_matrix()
    passive_x = Rotation.from_rotvec([-0.4 * np.sin(t), 0, 0]).as_matrix()
    rate = np.array([0, 0, 0.7]) + passive_z @ np.array([0.4 * np.cos(t), 0, 0])
    return passive_z @ passive_x, rate


def quaternion_of(matrix: np.ndarray) -> np.ndarray:
    """Ours is passive: that of the inverse rotation, for scipy."""
    return Rotation.from_matrix(matrix.T).as_quat()


def error_rad(q: np.ndarray, matrix: np.ndarray) -> float:
    return float((Rotation.from_quat(q) * Rotation.from_matrix(matrix)).magnitude())


def sampled(step_s: float, *, rates: bool = True, end_s: float = 4.0) -> SampledTrajectory:
    made = SampledTrajectory()
    for t in np.arange(0, end_s + step_s / 2, step_s):
        matrix, rate = coning(t)
        made.set_attitude(round(t * S), quaternion_of(matrix), rate if rates else None)
    return made


INSTANTS = np.arange(0, 4 * S, 7_654_321)


def worst(made: SampledTrajectory) -> tuple[float, float]:
    """(attitude error in rad, rate error in rad/s)."""
    attitudes, rates = made.q_icrs_to_sensor(INSTANTS), made.rate_sensor(INSTANTS)
    truths = [coning(t / S) for t in INSTANTS]
    return (
        max(error_rad(q, matrix) for q, (matrix, _) in zip(attitudes, truths, strict=True)),
        max(float(np.linalg.norm(w - rate)) for w, (_, rate) in zip(rates, truths, strict=True)),
    )


def test_with_rates_the_error_falls_with_the_fourth_power_of_the_step():
    coarse, fine = worst(sampled(0.2)), worst(sampled(0.1))
    assert coarse[0] < 0.6 * ARCSEC
    assert coarse[0] / fine[0] == pytest.approx(16, rel=0.1)
    assert coarse[1] / fine[1] == pytest.approx(8, rel=0.1)


def test_without_rates_with_the_second():
    coarse, fine = worst(sampled(0.2, rates=False)), worst(sampled(0.1, rates=False))
    assert coarse[0] / fine[0] == pytest.approx(4, rel=0.1)
    assert fine[0] > 100 * worst(sampled(0.1))[0]


@pytest.mark.parametrize("rates", [True, False])
def test_samples_are_met(rates):
    made = sampled(0.25, rates=rates)
    for t in np.arange(0, 4.1, 0.25):
        matrix, rate = coning(t)
        assert error_rad(made.q_icrs_to_sensor(round(t * S)), matrix) < 1e-12
        if rates:
            assert made.rate_sensor(round(t * S)) == pytest.approx(rate, abs=1e-12)


def test_the_rate_is_the_derivative_of_the_attitude():
    made, h = sampled(0.5), 1000
    for t in INSTANTS[1:-1:40]:
        a, b = (Rotation.from_quat(made.q_icrs_to_sensor(int(n))) for n in (t - h, t + h))
        turned = (b.inv() * a).as_rotvec() / (2e-9 * h)  # A(t + h) A(t - h)^T = exp(-[w x] 2 h)
        assert -turned == pytest.approx(made.rate_sensor(int(t)), abs=1e-6)


@pytest.mark.parametrize("rates", [True, False])
def test_a_constant_rate_is_exact(rates):
    true = trajectory.constant_rate(ra_deg=80, dec_deg=10, roll_deg=170, rate_deg_s=[3, -2, 40])
    made = SampledTrajectory()
    for t in range(0, 9 * S, S):
        made.set_attitude(t, true.q_icrs_to_sensor(t), true.rate_sensor(t) if rates else None)
    assert made.q_icrs_to_sensor(INSTANTS) == pytest.approx(true.q_icrs_to_sensor(INSTANTS), abs=1e-14)
    assert made.rate_sensor(INSTANTS) == pytest.approx(true.rate_sensor(INSTANTS), abs=1e-12)
    assert isinstance(made, Trajectory)


def test_an_orbit_by_samples():
    true = orbit.orbit(altitude_km=500, inclination_deg=98)
    made = SampledTrajectory()
    for t in range(0, 50 * S, 10 * S):
        made.set_attitude(
            t,
            true.q_icrs_to_sensor(t),
            true.rate_sensor(t),
            position_km=true.position_km(t),
            velocity_km_s=true.velocity_km_s(t),
        )
    at = np.arange(0, 40 * S, 123_456_789)
    assert made.position_km(at) == pytest.approx(true.position_km(at), abs=1e-4)  # h^4 / 384 n^4 r: 2.6 cm
    assert made.velocity_km_s(at) == pytest.approx(true.velocity_km_s(at), abs=1e-4)
    assert made.position_km(20 * S) == pytest.approx(true.position_km(20 * S), abs=1e-9)


def test_positions_alone_lie_on_straight_lines_and_velocities_alone_change_evenly():
    made = SampledTrajectory()
    made.set_attitude(0, [0, 0, 0, 1], position_km=[7000, 0, 0])
    made.set_attitude(2 * S, [0, 0, 0, 1], position_km=[7000, 14, 0])
    assert made.position_km(S // 2) == pytest.approx([7000, 3.5, 0])
    assert made.velocity_km_s(S) == pytest.approx([0, 7, 0])
    fast = SampledTrajectory()
    fast.set_attitude(0, [0, 0, 0, 1], velocity_km_s=[1, 0, 0])
    fast.set_attitude(2 * S, [0, 0, 0, 1], velocity_km_s=[3, 0, 8])
    assert fast.position_km(S) is None
    assert fast.velocity_km_s(S) == pytest.approx([2, 0, 4])
    assert made.sun_direction(S) is None


def test_the_sun_of_the_samples_is_the_observers():
    made = SampledTrajectory()
    for t, direction in ((0, [2, 0, 0]), (2 * S, [0, 5, 0])):
        made.set_attitude(t, [0, 0, 0, 1], position_km=[7000, 0, 0], sun_direction=direction)
    assert isinstance(made, TrajectoryWithSun)
    assert made.sun_direction(S) == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0])
    assert made.sun_direction(2 * S // 3) == pytest.approx([np.cos(np.pi / 6), 0.5, 0])
    observer = ObserverState.at(made, S, 2_145_916_837 * S)
    distance = np.linalg.norm(observer.sun_km)
    assert observer.sun_km / distance == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0])
    assert 1.47e8 < distance < 1.53e8
    assert observer.earth_to_sun_km - observer.sun_km == pytest.approx([7000, 0, 0], abs=1e-6)
    assert np.linalg.norm(observer.velocity_km_s) == pytest.approx(30, abs=1)  # the Earth's stays


def test_nothing_is_guessed():
    made = SampledTrajectory()
    with pytest.raises(BeyondTruthError, match="no sample is given yet"):
        made.q_icrs_to_sensor(0)
    with pytest.raises(BeyondTruthError):
        made.position_km(0)
    made.set_attitude(S, [0, 0, 0, 1])
    assert made.q_icrs_to_sensor(S) == pytest.approx([0, 0, 0, 1])
    made.set_attitude(2 * S, [0, 0, 0, 1])
    for outside in (S - 1, 2 * S + 1):
        with pytest.raises(BeyondTruthError, match=r"samples reach from 1 s to 2 s") as told:
            made.q_icrs_to_sensor(np.array([S, outside]))
        assert (told.value.asked_ns, told.value.first_ns, told.value.last_ns) == (outside, S, 2 * S)
        with pytest.raises(BeyondTruthError):
            made.rate_sensor(outside)


def test_it_forgets_what_nobody_needs():
    made = SampledTrajectory()
    needed = [0]
    heard: list[TruthSample] = []
    made.watch(heard.append, lambda: needed[0])
    for t in range(1000):
        needed[0] = (t - 3) * S + 1
        made.set_attitude(t * S, [0, 0, 0, 1])
    assert len(heard) == 1000
    assert [sample.t_ns for sample in made.samples] == [t * S for t in range(996, 1000)]
    assert made.q_icrs_to_sensor(needed[0]) == pytest.approx([0, 0, 0, 1])
    with pytest.raises(BeyondTruthError, match="any more"):
        made.q_icrs_to_sensor(S)


GOOD = {"t_ns": 5, "q_icrs_to_sensor": [0, 0, 0, 1]}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"t_ns": "5"}, "t_ns: found '5'"),
        ({"t_ns": 1.5}, "t_ns: found 1.5"),
        ({"t_ns": True}, "t_ns: found True"),
        ({"t_ns": 2**63}, "t_ns"),
        ({"q_icrs_to_sensor": [0, 0, 1]}, "q_icrs_to_sensor.*4 finite numbers"),
        ({"q_icrs_to_sensor": [0, 0, 0, 0]}, "not all zero"),
        ({"q_icrs_to_sensor": [0, 0, 0, float("nan")]}, "finite"),
        ({"q_icrs_to_sensor": ["0", 0, 0, 1]}, "q_icrs_to_sensor"),
        ({"rate_rad_s": [0, 0]}, "rate_rad_s.*3 finite numbers"),
        ({"sun_direction": [0, 0, 0]}, "sun_direction.*not all zero"),
        ({"rate": [0, 0, 0]}, "rate: is not a known item; allowed are t_ns"),
    ],
)
def test_a_wrong_sample_is_refused(change, says):
    with pytest.raises(ValueError, match=says):
        TruthSample.of(GOOD | change)


def test_samples_that_do_not_follow_are_refused():
    made = SampledTrajectory()
    made.set_attitude(S, [0, 0, 0, 1], [0, 0, 0.1])
    with pytest.raises(ValueError, match="allowed are times after"):
        made.set_attitude(S, [0, 0, 0, 1], [0, 0, 0.1])
    with pytest.raises(ValueError, match="gives q_icrs_to_sensor, t_ns; allowed are the items"):
        made.set_attitude(2 * S, [0, 0, 0, 1])
    with pytest.raises(ValueError, match="under 180 deg"):
        made.set_attitude(11 * S, [0, 0, 0, 1], [0, 0, 0.6])
    made.set_attitude(2 * S, [0, 0, 0, 1], [0, 0, 0.1])
    assert len(made.samples) == 2


finite = st.floats(-1e6, 1e6)


@given(
    st.builds(
        TruthSample,
        st.integers(0, 2**63 - 1),
        st.tuples(finite, finite, finite, st.floats(0.1, 1e6)),
        st.none() | st.tuples(finite, finite, finite),
        st.none() | st.tuples(finite, finite, finite),
        st.none() | st.tuples(finite, finite, finite),
    )
)
def test_a_sample_survives_the_way_through_a_journal(sample):
    import json

    assert TruthSample.of(json.loads(json.dumps(sample.as_dict()))) == sample
