"""Telemetry of frames against the device's frames and the truth."""

from __future__ import annotations

import itertools
import struct

import numpy as np
import pytest

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import MS, Bench, at_rest, make, unit
from st_emulator.dialects.sagitta.telemetry import histogram_of


@pytest.fixture(scope="module", params=["roja1", "zy3"])
def tracking(request: pytest.FixtureRequest) -> Bench:
    """A unit that tracks, with its time set, past a frame's result."""
    bench = make(request.param).boot()
    bench.set_time()
    bench.run_until(lambda: bench.solution()["valid"])
    return bench


def of_one_frame(bench: Bench, *ids: int) -> tuple[list[client.Frame], object]:
    """Telemetry that all tells of one frame, and its record."""
    number = bench.device.frame_counters.frames_processed
    bench.run_until(lambda: bench.device.frame_counters.frames_processed > number)
    record = bench.device.last_frame
    bench.frames.clear()
    bench.put(b"".join(client.request(client.REQUEST, id_) for id_ in ids))
    bench.run(150)
    assert bench.device.last_frame is record
    assert [frame.id for frame in bench.frames] == list(ids)
    assert all(len(frame.body) == client.TELEMETRY_BODY_BYTES[frame.id] for frame in bench.frames)
    return list(bench.frames), record


def test_matched_stars_are_those_of_the_sky(tracking: Bench) -> None:
    (frame,), record = of_one_frame(tracking, client.MATCHED)
    count, rows = client.matched(frame)
    assert count >= 6
    truth = tracking.emulator.scene.truth(record.pixels)
    true = {star.hip: (star.x_px, star.y_px) for star in truth.stars}
    stars = rows[: min(count, 16)]
    assert len({row[0] for row in stars}) == len(stars)
    assert {row[0] for row in stars} <= set(true)
    off = np.array([(x - true[hip][0], y - true[hip][1]) for hip, x, y, _, _ in stars])
    # A close pair makes one spot at the middle of its light, which the truth knows as two stars.
    assert np.abs(off).max() < 1
    assert np.median(np.abs(off)) < 0.1
    errors = np.array([row[3:] for row in stars])
    assert 0 < np.sqrt(np.mean(np.square(errors))) < 0.2
    # Measured less expected is measured less true, but for the attitude's own error and such pairs.
    assert np.median(np.abs(off - errors)) < 0.05
    assert np.median(np.abs(off - errors)) < np.median(np.abs(off + errors)) / 2
    assert all(row == (0, 0, 0, 0, 0) for row in rows[count:])


def test_centroids_and_blobs_agree(tracking: Bench) -> None:
    (spots, blobs, stars, solution), record = of_one_frame(
        tracking, client.CENTROIDS, client.BLOBS, client.MATCHED, client.SOLUTION
    )
    count, rows = client.centroids(spots)
    told = client.solution(solution)
    assert count == told["centroided"] == len(record.result.spots)
    assert told["matched"] == client.matched(stars)[0] == len(record.result.stars)
    magnitudes = [row[2] for row in rows[:count]]
    assert magnitudes == sorted(magnitudes)
    zero_point = tracking.emulator.profile.electrons_per_s_mag0
    assert zero_point > 0
    all_blobs, used, skipped, places = client.blobs(blobs)
    assert (used, skipped) == (count, 0)
    assert all_blobs == count + told["removed"]
    for (x, y, _), place in zip(rows[:8], places, strict=False):
        assert place == (round(x), round(y)) or count < 8
    matched = {(x, y) for _, x, y, _, _ in client.matched(stars)[1]}
    assert len(matched & {(x, y) for x, y, _ in rows}) >= 6


def test_magnitudes_are_those_of_the_stars(tracking: Bench) -> None:
    (spots, stars), record = of_one_frame(tracking, client.CENTROIDS, client.MATCHED)
    truth = {star.hip: star.hp_mag for star in tracking.emulator.scene.truth(record.pixels).stars}
    places = {(x, y): magnitude / 10 for x, y, magnitude in client.centroids(spots)[1]}
    off = [
        places[x, y] - truth[hip] for hip, x, y, _, _ in client.matched(stars)[1] if hip and (x, y) in places
    ]
    assert len(off) >= 6
    assert abs(np.median(off)) < 0.3


def test_histogram_counts_each_pixel(tracking: Bench) -> None:
    (frame,), record = of_one_frame(tracking, client.HISTOGRAM)
    image, bits = record.pixels.full(), record.pixels.bits
    rows, columns = image.shape
    sections = client.histogram(frame)
    for number, section in enumerate(sections):
        down, right = divmod(number, 2)
        quarter = image[down * rows // 2 :, right * columns // 2 :][: rows // 2, : columns // 2]
        edges = [(2**bits * part + 8) // 9 for part in range(10)]  # the smallest number of each bin
        wanted = [int(((quarter >= low) & (quarter < high)).sum()) for low, high in itertools.pairwise(edges)]
        assert list(section) == wanted
    assert sum(map(sum, sections)) == rows * columns


def test_histogram_is_of_the_newest_image() -> None:
    bench = make().boot()
    bench.run_until(lambda: bench.solution()["valid"])
    assert bench.status(client.SET, 10, struct.pack("<BBHHB", 1, 0, 10, 0, 0)) == 0
    bench.run_until(lambda: bench.device.image_memory.image is not None)
    kept = bench.device.image_memory.image
    assert kept is not None
    (frame,), record = of_one_frame(bench, client.HISTOGRAM)
    (frame,), record = of_one_frame(bench, client.HISTOGRAM)
    assert record.index > kept.frame_index

    def wanted(pixels) -> list[tuple[int, ...]]:
        return [tuple(section) for section in histogram_of(pixels.full(), pixels.bits).values()]

    assert client.histogram(frame) == wanted(record.pixels)
    assert client.histogram(frame) != wanted(kept.pixels)


def test_the_threshold_is_that_of_the_search() -> None:
    profile = unit()
    figures = {"window_sigma": 12.0, "sigma": 9.0, "tau_pre_electrons": 0.0}
    profile = profile.model_copy(update={"detection": profile.detection.model_copy(update=figures)})
    bench = Bench(profile).boot()
    bench.run_until(lambda: bench.device.frame_counters.frames_processed == 1)
    for factor in (9.0, 12.0):  # lost in space, then tracking
        (auto,), record = (
            of_one_frame(bench, client.AUTO_BLOB)
            if factor == 12.0
            else (
                (bench.telemetry(client.AUTO_BLOB),),
                bench.device.last_frame,
            )
        )
        (threshold,) = struct.unpack("<f", auto.data)
        assert threshold == pytest.approx(factor * record.result.noise_dn, rel=1e-6)


def test_histogram_of_odd_sides_and_all_values() -> None:
    image = np.arange(5 * 7, dtype=np.uint16).reshape(5, 7) * 1800
    sections = histogram_of(image, 16)
    assert [sum(section) for section in sections.values()] == [2 * 3, 2 * 4, 3 * 3, 3 * 4]
    assert histogram_of(np.full((2, 2), 65535, np.uint16), 16)["section_a"] == [0] * 8 + [1]


def test_threshold_and_blob_statistics(tracking: Bench) -> None:
    (auto, statistics, spots, stars), record = of_one_frame(
        tracking, client.AUTO_BLOB, client.BLOB_STATISTICS, client.CENTROIDS, client.MATCHED
    )
    (threshold,) = struct.unpack("<f", auto.data)
    profile = tracking.emulator.profile
    noise = record.result.noise_dn
    least = max(1.0, profile.detection.tau_pre_electrons / profile.detector.electrons_per_dn)
    assert threshold == pytest.approx(max(least, profile.detection.window_sigma * noise), rel=1e-6)
    count, rows = client.blob_statistics(statistics)
    assert count == client.matched(stars)[0]
    shown = min(client.centroids(spots)[0], 16)
    assert {row[0] for row in rows[:shown]} == {round(noise)}
    assert {row[1] for row in rows[:shown]} == {round(threshold)}
    matched = {(x, y) for _, x, y, _, _ in client.matched(stars)[1]}
    for row, (x, y, _) in zip(rows[:shown], client.centroids(spots)[1], strict=False):
        assert row[2] == 1 or (x, y) not in matched
    assert all(row == (0, 0, 0, 0) for row in rows[shown:])


def test_what_has_no_frame_yet_is_zeros() -> None:
    bench = at_rest()
    for id_ in (28, 36, 37, 39, 40, 49):
        assert bench.telemetry(id_).data == bytes(client.TELEMETRY_BODY_BYTES[id_] - 20)
    told = bench.solution()
    assert (told["valid"], told["q"], told["stable"]) == (0, (0, 0, 0, 0), 0)


def test_power_and_temperature() -> None:
    bench = at_rest()
    assert struct.unpack("<3f", bench.telemetry(client.TEMPERATURE).data) == (20.0, 20.0, 20.0)
    pairs = struct.unpack("<16f", bench.telemetry(client.POWER).data)
    assert pairs[::2] == (0.0,) * 8
    assert pairs[5] == pytest.approx(1.8)
    assert pairs[7] == pytest.approx(2.5)
    assert pairs[9] == pytest.approx(2.1)
    assert pairs[13] == pytest.approx(3.3)


def test_each_has_status_counter_and_time() -> None:
    bench = at_rest()
    frames = [bench.telemetry(id_) for id_ in client.TELEMETRY_BODY_BYTES]
    assert [frame.counter for frame in frames] == list(range(len(frames)))
    times = [frame.time_us for frame in frames]
    assert times == sorted(times)
    assert times[-1] - times[0] == (frames[-1].t_ns - frames[0].t_ns) // 1000 or times[-1] > times[0]
    assert frames[0].t_ns // MS > times[0] // 1000  # from the program's start, not from power-on
