"""RATE_ONLY in the languages that have no word for it: frames are looked at, no attitude is known.

Each wire is read by its own decoder. Behind it the attitude is found, and told as ever.
"""

from __future__ import annotations

import pytest

from hil_tests.dialects.canopen import bench as canopen
from hil_tests.dialects.canopen.client import STATES
from hil_tests.dialects.nos3 import bench as nos3
from hil_tests.dialects.sagitta import bench as sagitta
from hil_tests.dialects.sagitta.client import SOLUTION, solution
from hil_tests.unit.tumbling import tumble
from st_emulator.device.star_tracker import StarTracker
from st_emulator.firmware_model.modes import Mode

LISA, LISA_OK, TRACKING_OK, LISA_LOW_CONFIDENCE = 1, 4, 5, 8
FRAMES = 8  # 2 s


def is_rate_only(device: StarTracker) -> bool:
    return device.mode is Mode.RATE_ONLY


def test_sagitta_goes_on_with_invalid_solutions_of_lisa(monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch, FRAMES)
    bench = sagitta.make().boot()
    bench.subscribe(SOLUTION)
    bench.run_until(lambda: is_rate_only(bench.device))
    bench.frames.clear()
    bench.run(1000)
    assert is_rate_only(bench.device)
    told = [solution(frame) for frame in bench.subscribed(SOLUTION)]
    assert len(told) == 4, "one each frame"
    for one in told:
        assert (one["mode"], one["valid"], one["strategy"], one["stable"]) == (
            LISA,
            0,
            LISA_LOW_CONFIDENCE,
            0,
        )
        assert one["centroided"] > 5, "the image was looked at"
    bench.run_until(lambda: bench.device.mode is Mode.TRACKING)
    bench.frames.clear()
    bench.run(2000)
    strategies = [solution(frame)["strategy"] for frame in bench.subscribed(SOLUTION)]
    assert set(strategies) <= {LISA_OK, TRACKING_OK}
    assert solution(bench.subscribed(SOLUTION)[-1])["valid"] == 1


def test_nos3_says_not_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch, FRAMES)
    bench = nos3.make().boot()
    bench.run(600)
    assert is_rate_only(bench.emulator.device)
    for _ in range(4):
        assert bench.data()["valid"] == 0
        bench.run(200)
    assert is_rate_only(bench.emulator.device)
    assert bench.until_valid()["valid"] == 1


def test_the_card_stays_in_star_track_and_tells_no_image(monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch, FRAMES)
    bench = canopen.make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run(900)
    assert is_rate_only(bench.emulator.device)
    assert bench.state == STATES["STAR_TRACK"]
    assert bench.sdo.number(0x4002, 6) == 0
    assert bench.attitudes == []
    bench.run(3000)
    assert bench.state == STATES["STAR_TRACK"]
    assert len(bench.attitudes) >= 4
    assert bench.sdo.number(0x4002, 6) == 1


@pytest.mark.parametrize("state", ["STANDBY", "LOW_POWER", "CAPTURE", "ERROR"])
def test_the_card_leaves_it_when_asked(monkeypatch: pytest.MonkeyPatch, state: str) -> None:
    tumble(monkeypatch)
    bench = canopen.make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run(900)
    assert is_rate_only(bench.emulator.device)
    bench.ask_for(state)
    assert bench.state == STATES[state]
