"""The unit file's section [rate]: what it becomes, its bounds, and that no section changes nothing."""

from __future__ import annotations

import math
import re

import pytest

from st_emulator.device.calibration import firmware_configuration
from st_emulator.device.parameters import default_parameters
from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.configuration import FirmwareConfiguration
from st_emulator.units.profile import parse_unit, unit_names, unit_text

SECTION = """
[rate]
fusion_distance_px = 2.0
piece_gap_px = 4
compensation = "displacement"
least_speed_px_s = 12.0
tolerance_px = 1.0
min_stars = 3
frames_to_rate_only = 4
identify_below_deg_s = 3.0
"""


# A unit with a rolling shutter and with no section of its own.
PLAIN = re.sub(r"(?ms)^\[rate\]\n.*?(?=^\[)", "", unit_text("aps_rs")[1])


def configuration(text: str) -> FirmwareConfiguration:
    profile = parse_unit(text, "unit.toml")
    return firmware_configuration(profile, default_parameters(profile))


def test_every_key_reaches_the_firmware() -> None:
    found = configuration(PLAIN + SECTION)
    assert found.rate is not None
    assert found.rate.fusion_distance_px == 2.0
    assert found.detection.piece_gap_px == 4
    assert found.rate.compensation == "displacement"
    assert found.rate.least_speed_px_s == 12.0
    assert found.rate.tolerance_px == 1.0
    assert found.rate.min_stars == 3
    assert found.rate.frames_to_rate_only == 4
    assert found.rate.identify_below_rad_s == pytest.approx(math.radians(3.0))


def test_a_cluster_centroid_is_a_unit_s_choice() -> None:
    text = unit_text("aps_rs")[1].replace('centroid = "com"', 'centroid = "cluster"')
    assert configuration(text).detection.centroid == "cluster"


@pytest.mark.parametrize("name", [name for name in unit_names() if "[rate]" not in unit_text(name)[1]])
def test_without_the_section_nothing_is_kept(name: str) -> None:
    found = configuration(unit_text(name)[1])
    assert found.rate is None
    assert found.detection.piece_gap_px == 0


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("compensation", '"streaks"', "streak"),
        ("min_stars", "1", "2"),
        ("piece_gap_px", "0", "1"),
        ("frames_to_rate_only", "0", "1"),
        ("tolerance_px", "0", "0"),
        ("identify_below_deg_s", "-1", "0"),
    ],
)
def test_a_bad_value_is_named_with_what_is_allowed(key: str, value: str, said: str) -> None:
    lines = [f"{key} = {value}" if line.startswith(f"{key} =") else line for line in SECTION.splitlines()]
    with pytest.raises(ConfigurationError) as raised:
        parse_unit(PLAIN + "\n".join(lines), "unit.toml")
    assert "unit.toml" in str(raised.value)
    assert f"rate.{key}" in str(raised.value)
    assert said in str(raised.value)


def test_the_rate_below_which_stars_are_identified_is_required() -> None:
    text = SECTION.replace("identify_below_deg_s = 3.0\n", "")
    with pytest.raises(ConfigurationError, match=r"rate\.identify_below_deg_s"):
        parse_unit(PLAIN + text, "unit.toml")
