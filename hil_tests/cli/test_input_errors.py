"""Unit and scenario files that are wrong: one line that names file, key and what is allowed."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.bench.scenario import Scenario, parse_scenario
from st_emulator.errors import ConfigurationError
from st_emulator.units.profile import load_unit, parse_unit, unit_names
from st_emulator.units.validation import validate

ROJA1 = (resources.files("st_emulator") / "units/roja1.toml").read_text(encoding="utf-8")


def changed(line_start: str, new_line: str, text: str = ROJA1) -> str:
    """A unit file with the line that starts so replaced; the line must be there."""
    lines = text.splitlines()
    (number,) = [n for n, line in enumerate(lines) if line.startswith(line_start)]
    lines[number] = new_line
    return "\n".join(lines)


UNIT_ERRORS = {
    "no TOML": ("[unit\n", ("not valid TOML",)),
    "unknown key": (changed("columns =", "colums = 752"), ("detector.colums", "not a known key", "columns")),
    "unknown table": (ROJA1 + "\n[detectr]\n", ("detectr", "not a known key", "detector, exclusion")),
    "missing key": (
        changed("columns =", ""),
        ("detector.columns", "missing", "a whole number from 64 to 8192"),
    ),
    "missing table": (ROJA1.split("[requirements]")[0].split("[wire]")[0], ("wire", "missing", "apid")),
    "too small": (changed("columns =", "columns = 12"), ("detector.columns", "found 12", "from 64 to 8192")),
    "text for a number": (changed("prnu =", 'prnu = "x"'), ("detector.prnu", "found 'x'", "from 0 to 0.2")),
    "no number": (
        changed("focal_length_mm =", "focal_length_mm = nan"),
        ("focal_length_mm", "nan", "over 0"),
    ),
    "infinite": (changed("k1 =", "k1 = inf"), ("optics.k1", "found inf", "a number")),
    "a fraction": (changed("bits =", "bits = 10.5"), ("detector.bits", "10.5", "whole number from 8 to 16")),
    "name": (changed("name =", 'name = "../x"'), ("unit.name", "'../x'", "text that matches")),
    "algorithm": (changed("algorithm =", 'algorithm = "grid"'), ("identification.algorithm", "'pyramid'")),
    "a table for a value": (ROJA1.replace("[wire]", "[wire.apid]"), ("wire.",)),
    "a value for a table": (
        "wire = 3\n" + ROJA1.split("[wire]")[0],
        ("wire", "found 3", "a table with the keys apid"),
    ),
    "exposure": (
        changed("exposure_ms =", "exposure_ms = 249.0").replace(
            "frame_period_ms = 250", "frame_period_ms = 240"
        ),
        ("timing", "exposure_ms = 249", "frame_period_ms = 240"),
    ),
    "exposure beyond the parameter's range": (
        changed("exposure_ms =", "exposure_ms = 300.0"),
        ("timing.exposure_ms", "found 300.0", "from 0.1 to 250"),
    ),
    "CAN node": (changed("node =", "node = 128"), ("can.node", "found 128", "whole number from 1 to 127")),
    "identifier width": (
        changed("identifier_bits =", "identifier_bits = 12"),
        ("can.identifier_bits", "found 12", "one of 11, 29"),
    ),
    "CAN padding": (changed("padding =", "padding = 256"), ("can.padding", "256", "from -1 to 255")),
    "separation time": (
        changed("separation_time_us =", "separation_time_us = 950"),
        ("can.separation_time_us", "950", "100 to 900 in steps of 100", "0 to 127000"),
    ),
    "a fraction of a CAN period": (
        changed("heartbeat_ms =", "heartbeat_ms = 0.5"),
        ("can.heartbeat_ms", "found 0.5", "a whole number from 0 to 60000"),
    ),
    "heartbeats without end": (
        changed("heartbeat_ms =", "heartbeat_ms = 1"),
        ("can", "heartbeat_ms = 1", "0 (never) and 10 to 60000"),
    ),
    "data bit rate": (
        changed("data_bitrate =", "data_bitrate = 500000"),
        ("can", "data_bitrate = 500000", "bitrate = 1000000", "the same or more"),
    ),
    "base between the steps": (
        changed("telecommand =", "telecommand = 0x601"),
        ("can", "identifiers.telecommand = 0x601", "multiples of 0x80 from 0 to 0x780"),
    ),
    "base of 29 bits": (
        changed("telecommand =", "telecommand = 0x1000"),
        ("can", "identifiers.telecommand = 0x1000", "identifier_bits = 11"),
    ),
    "base beyond 29 bits": (
        changed("telecommand =", "telecommand = 0x20000000"),
        ("can.identifiers.telecommand", "found 536870912", "from 0 to 536870784"),
    ),
    "two frames of one base": (
        changed("status =", "status = 0x380"),
        ("can", "identifiers.rates and identifiers.status are both 0x380", "different"),
    ),
    "unknown CAN frame": (
        changed("heartbeat =", "hartbeat = 0x700"),
        ("can.identifiers.hartbeat", "not a known key", "telecommand, heartbeat"),
    ),
    "true or false": (changed("pipelined =", "pipelined = 3"), ("timing.pipelined", "true or false")),
    "costs": (
        changed("cycle_costs =", 'cycle_costs = "z80"'),
        ("processor.cycle_costs", "z80", "arm926ej_s"),
    ),
}


def test_a_unit_file_need_not_speak_of_can():
    before, rest = ROJA1.split("[can]")
    unit = parse_unit(before + "[requirements]" + rest.split("[requirements]")[1], "here")
    shipped = load_unit("roja1").can
    assert unit.can.identifier_table() == shipped.identifier_table()
    assert unit.can.model_copy(update={"identifiers": shipped.identifiers}) == shipped
    assert parse_unit(changed("node =", "node = 99").replace("status = 0x480", ""), "here").can.node == 99


def test_identifiers_of_29_bits_have_bases_of_their_own():
    text = changed("identifier_bits =", "identifier_bits = 29").split("[can.identifiers]")[0]
    table = parse_unit(text + "[can.identifiers]\nsync = 0x80\n", "here").can.identifier_table(5)
    assert (table.extended, table.telecommand, table.identifier("sync")) == (True, (0x600 << 18) + 5, 0x80)
    with pytest.raises(ConfigurationError, match=r"^CAN node 0: allowed is a whole number from 1 to 127$"):
        load_unit("zy3").can.identifier_table(0)


@pytest.mark.parametrize("name", UNIT_ERRORS)
def test_unit_file(name, refused, tmp_path):
    text, says = UNIT_ERRORS[name]
    path = tmp_path / "my unit.toml"
    path.write_text(text)
    refused("run", path, "--speed", "max", "--seconds", "1", says=(str(path), *says))


@pytest.mark.parametrize(
    "arguments", [("solve", "frame.png", "--unit"), ("campaign", "accuracy", "--unit"), ("demo", "--unit")]
)
def test_other_commands_refuse_a_wrong_unit_as_well(arguments, refused, tmp_path):
    path = tmp_path / "unit.toml"
    path.write_text(
        changed("cycle_costs =", 'cycle_costs = "z80"') if arguments[0] == "campaign" else "x = 1\n"
    )
    refused(*arguments, path, *(["--out", tmp_path] if arguments[0] == "demo" else []), says=(str(path),))


def test_unknown_unit(refused):
    refused("run", "roja2", says=("roja2", *unit_names(), ".toml"))


def test_unit_file_that_is_not_there_or_cannot_be_read(refused, tmp_path):
    refused("run", tmp_path / "none.toml", says=("none.toml", "No such file", "TOML"))
    refused("run", tmp_path, says=(str(tmp_path), "directory"))
    (tmp_path / "unit.toml").write_bytes(b"\x89PNG\r\n\xff")
    refused("run", tmp_path / "unit.toml", says=("unit.toml", "not a text file"))


def test_a_slip_is_told_before_the_key_that_it_makes_missing():
    with pytest.raises(ConfigurationError, match=r"^here: detector\.colums: .*\(and 1 more\)$"):
        parse_unit(changed("columns =", "colums = 752"), "here")


SLEW = """
[trajectory]
kind = "slew"
ra_deg = 10
dec_deg = 20
[[trajectory.segments]]
kind = "hold"
duration_s = 1
[[trajectory.segments]]
"""
COMMAND = "[[telecommands]]\nat_s = 0.1\nname = 'ping'\n[[telecommands]]\nat_s = 0.5\n"

SCENARIO_ERRORS = {
    "no TOML": ("duration_s = = 3", ("not valid TOML", "line 1")),
    "unknown key": ("duration = 3", ("duration", "not a known key", "duration_s")),
    "unknown key inside": ("[sky]\nsuns = 3", ("sky.suns", "not a known key", "false_spots")),
    "infinite": ("duration_s = inf", ("duration_s", "inf", "over 0")),
    "no time": ("duration_s = nan", ("duration_s", "nan", "over 0")),
    "negative": ("duration_s = -1", ("duration_s", "found -1", "over 0")),
    "schema": ("schema = 2", ("schema", "found 2", "allowed is 1")),
    "no zone": ("start_utc = 2026-01-01T00:00:00", ("start_utc", "time zone")),
    "no date": ("start_utc = 'soon'", ("start_utc", "'soon'", "2026-01-15T00:00:00Z")),
    "too early": ("start_utc = 1950-01-01T00:00:00Z", ("start_utc", "1950", "1972-01-01", "2090-01-01")),
    "too late": ("start_utc = 2095-01-01T00:00:00Z", ("start_utc", "2095", "1972-01-01", "2090-01-01")),
    "first second ever": ("start_utc = 0001-01-01T00:00:00+14:00", ("start_utc", "1972-01-01")),
    "trajectory": ("[trajectory]\nkind = 'spin'", ("trajectory.kind", "'spin'", "inertial", "orbit")),
    "no kind": ("[trajectory]\nra_deg = 1", ("trajectory.kind", "missing", "inertial", "orbit")),
    "range": (
        "[trajectory]\nkind='inertial'\nra_deg=1\ndec_deg=91",
        ("trajectory.dec_deg", "91", "from -90 to 90"),
    ),
    "half open": (
        "[trajectory]\nkind='inertial'\nra_deg=360\ndec_deg=1",
        ("trajectory.ra_deg", "from 0 and under 360"),
    ),
    "segment": (SLEW + "kind = 'jump'", ("trajectory.segments.1.kind", "'jump'", "hold", "slew_to", "rate")),
    "segment without kind": (SLEW + "duration_s = 1", ("trajectory.segments.1.kind", "missing", "slew_to")),
    "in a segment": (
        SLEW + "kind = 'slew_to'\nduration_s = 1\nra_deg = 400\ndec_deg = 0",
        ("trajectory.segments.1.ra_deg", "400", "under 360"),
    ),
    "unknown in a segment": (
        SLEW + "kind = 'rate'\nduration_s = 1\nrate_deg_s = [0, 0, 1]\nramp = 3",
        ("trajectory.segments.1.ramp", "not a known key", "ramp_s"),
    ),
    "missing in a segment": (
        SLEW + "kind = 'slew_to'\nra_deg = 1\ndec_deg = 0",
        ("trajectory.segments.1.duration_s", "missing", "over 0"),
    ),
    "vector": (
        SLEW + "kind = 'rate'\nduration_s = 1\nrate_deg_s = [0, 1]",
        ("trajectory.segments.1.rate_deg_s", "a number"),
    ),
    "no segments": (
        "[trajectory]\nkind='slew'\nra_deg=1\ndec_deg=2\nsegments=[]",
        ("trajectory.segments", "at least 1"),
    ),
    "orbit": (
        "[trajectory]\nkind='orbit'\naltitude_km=500\ninclination_deg=98\nboresight=[0,0,0]",
        ("trajectory", "boresight", "not all zero"),
    ),
    "false spots": (
        "[sky]\nfalse_spots = 2\nfalse_spot_magnitudes = [6, 3]",
        ("sky.false_spot_magnitudes", "[6, 3]", "brighter"),
    ),
    "unknown telecommand": (COMMAND + "name = 'pong'", ("telecommands.1", "'pong'", "ping")),
    "unknown field": (
        COMMAND + "name = 'ping'\nfields = {x = 1}",
        ("telecommands.1", "ping: x = 1", "no fields"),
    ),
    "field's name": (
        COMMAND + "name = 'function'\nfields = {function_id = 'GO_HOME'}",
        ("telecommands.1", "function_id = 'GO_HOME'", "GO_STANDBY"),
    ),
    "field's range": (
        COMMAND + "name = 'hk_set_interval'\nfields = {intervals = [{structure_id = 1, interval_ms = 1}]}",
        ("telecommands.1", "interval_ms = 1", "250..3600000"),
    ),
    "field's kind": (
        COMMAND + "name = 'hk_enable'\nfields = {structure_ids = 5}",
        ("telecommands.1", "structure_ids = 5", "list"),
    ),
    "field missing": (COMMAND + "name = 'set_time'", ("telecommands.1", "time")),
    "both": (COMMAND + "name = 'ping'\nraw_hex = 'c0'", ("telecommands.1", "either name", "raw_hex")),
    "raw": (COMMAND + "raw_hex = 'c'", ("telecommands.1", "hexadecimal")),
    "before power-on": (
        COMMAND.replace("0.5", "-1") + "name = 'ping'",
        ("telecommands.1.at_s", "-1", "from 0"),
    ),
    "unknown parameter": ("[parameters]\nexposure = 5", ("parameters.exposure", "allowed are exposure_us")),
    "read only": ("[parameters]\nboot_count = 5", ("parameters.boot_count", "not a parameter to set")),
    "parameter's range": ("[parameters]\nexposure_us = 5", ("parameters.exposure_us", "100..250000")),
    "parameter's kind": ("[parameters]\nexposure_us = 'x'", ("parameters.exposure_us", "'x'", "number")),
}


@pytest.mark.parametrize("name", SCENARIO_ERRORS)
def test_scenario(name, refused, tmp_path):
    text, says = SCENARIO_ERRORS[name]
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    journal = tmp_path / "journal.jsonl"
    journal.write_text("kept")
    refused(
        *("run", "roja1", "--scenario", path, "--speed", "max", "--seconds", "1", "--journal", journal),
        says=(str(path), *says),
    )
    assert journal.read_text() == "kept"  # nothing is opened before everything is known to be right


def test_scenario_that_is_not_there(refused, tmp_path):
    refused("run", "roja1", "--scenario", tmp_path / "no.toml", says=("no.toml", "No such file", "scenario"))


leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
values = st.recursive(
    leaves,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
keys = st.sampled_from([*Scenario.model_json_schema(by_alias=True)["properties"], "kind", "x"])


@given(
    st.dictionaries(
        keys, values | st.fixed_dictionaries({"kind": st.sampled_from(["slew", "orbit", "x"])}), max_size=4
    )
)
def test_whatever_stands_in_a_scenario_gives_a_scenario_or_one_line(data):
    try:
        scenario = validate(Scenario, data, "here")
    except ConfigurationError as error:
        told = str(error)
        assert told.startswith("here: ") and "\n" not in told  # noqa: PT018
    else:
        assert scenario.origin == "here"


def test_what_is_right_is_taken(tmp_path):
    for name in unit_names():
        assert load_unit(name).name == name
    scenario = parse_scenario(SLEW + "kind = 'rate'\nduration_s = 1\nrate_deg_s = [0, 0, 1]", "here")
    assert (scenario.where, Scenario(name="x").where) == ("here", "scenario x")
    copy = tmp_path / "roja1.toml"
    copy.write_text(ROJA1)
    assert load_unit(str(copy)).unit == load_unit("roja1").unit
    assert load_unit(str(copy)).origin == str(copy)


def test_examples_are_valid():
    examples = Path(__file__).parents[2] / "examples"
    for path in examples.glob("*.toml"):
        parse_scenario(path.read_text(encoding="utf-8"), str(path))
