"""The Sun near the boresight blinds a unit, which says so; away from it, it works."""

from __future__ import annotations

import erfa
import numpy as np
import pytest

from hil_tests.vectors import reference_decoder
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import InertialTrajectory, Scenario, ScenarioTelecommand
from st_emulator.units.profile import load_unit

BLINDED = 4


def sun_deg(jd_tt: float) -> tuple[float, float]:
    """Right ascension and declination of the Sun, by ERFA's epv00 and not by our code."""
    heliocentric, _ = erfa.epv00(jd_tt, 0.0)
    x, y, z = -np.asarray(heliocentric["p"])
    return float(np.degrees(np.arctan2(y, x)) % 360), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


def reports(unit: str, ra_deg: float, dec_deg: float) -> list[dict]:
    sent = bytearray()
    scenario = Scenario(
        trajectory=InertialTrajectory(ra_deg=ra_deg % 360, dec_deg=dec_deg),
        telecommands=[
            ScenarioTelecommand(at_s=0.6, name="function", fields={"function_id": 2, "arguments": {}})
        ],
    )
    emulator = Emulator(load_unit(unit), scenario, transmit=lambda data, t_ns: sent.extend(data))
    emulator.advance(3_000_000_000)
    frames = reference_decoder.slip_frames(bytes(sent))
    packets = [reference_decoder.decode_telemetry(raw) for raw in frames]
    return [item["fields"] for item in packets if (item["service"], item["subservice"]) == (130, 1)]


@pytest.mark.parametrize("unit", ["roja1", "zy3", "aps_rs"])
def test_blinded_well_inside_the_exclusion_angle(unit: str) -> None:
    ra, dec = sun_deg(2461055.5)  # 2026-01-15, the default date of a scenario
    inside = load_unit(unit).exclusion.sun_deg * 0.75
    for report in reports(unit, ra, dec + inside):
        assert not report["valid"]
        assert report["reasons"] & BLINDED


@pytest.mark.parametrize("unit", ["roja1", "zy3", "aps_rs"])
def test_not_blinded_well_outside_it(unit: str) -> None:
    ra, dec = sun_deg(2461055.5)
    outside = load_unit(unit).exclusion.sun_deg * 1.3
    found = reports(unit, ra, dec + outside)
    assert found
    assert not any(report["reasons"] & BLINDED for report in found)
