"""Attitudes from files written by hand: CSV and AEM, each with its conventions."""

from __future__ import annotations

import contextlib
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from st_emulator.tai import tai_ns_from_utc
from st_emulator.world.aem import is_aem, samples_of_aem
from st_emulator.world.attitude_file import mounted, samples_of_csv
from st_emulator.world.epochs import tai_ns_of

S = 1_000_000_000
START = tai_ns_from_utc("2026-01-15T00:00:00Z")
#: The body turned by 90 deg about z to the east: its x axis looks along ICRS y. Passive, from ICRS to body.
EAST = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
MAS = np.radians(1e-3 / 3600)


def axes(q: object) -> np.ndarray:
    """The body's axes in ICRS, one a row: of a passive quaternion from ICRS to the body."""
    return Rotation.from_quat(q).as_matrix().T


# -- CSV


def test_csv():
    text = (
        "# made by hand\n t_s, q_w ,q_x,q_y,q_z,rate_x_deg_s,rate_y_deg_s,rate_z_deg_s\n\n"
        f"-1,1,0,0,0,0,0,90\n0.25,{EAST[3]},0,0,{EAST[2]},0,0,90\n"
    )
    before, after = samples_of_csv(text, START)
    assert (before.t_ns, after.t_ns) == (-S, S // 4)
    assert after.q_icrs_to_sensor == pytest.approx(EAST)
    assert after.rate_rad_s == pytest.approx((0, 0, np.pi / 2))
    assert axes(after.q_icrs_to_sensor)[0] == pytest.approx([0, 1, 0])


def test_csv_with_dates_and_the_other_direction():
    text = f"q_x,q_y,q_z,q_w,utc\n0,0,{-EAST[2]},{EAST[3]},2026-01-15T00:00:01.000000002Z\n"
    (sample,) = samples_of_csv(text, START, "body_to_icrs")
    assert sample.t_ns == S + 2
    assert sample.q_icrs_to_sensor == pytest.approx(EAST)


def test_csv_with_place_and_sun():
    text = (
        "t_s,q_x,q_y,q_z,q_w,x_km,y_km,z_km,vx_km_s,vy_km_s,vz_km_s,sun_x,sun_y,sun_z\r\n"
        "0,0,0,0,1,7000,0,0,0,7.5,0,0,0,1\r\n2,0,0,0,1,7000,15,0,0,7.5,0,0,1,1\r\n"
    )
    trajectory = mounted(samples_of_csv(text, START), [0, 0, 0, 1])
    assert trajectory.position_km(S) == pytest.approx([7000, 7.5, 0])
    assert trajectory.sun_direction(2 * S) == pytest.approx([0, np.sqrt(0.5), np.sqrt(0.5)])


def test_the_sensor_is_mounted_on_the_body():
    row = ",".join(str(value) for value in (0, *EAST, 0.1, 0, 0))
    header = "t_s,q_x,q_y,q_z,q_w,rate_x_rad_s,rate_y_rad_s,rate_z_rad_s"
    samples = samples_of_csv(f"{header}\n{row}\n", START)
    samples.append(type(samples[0])(S, samples[0].q_icrs_to_sensor, samples[0].rate_rad_s))
    # the boresight along the body's x: sensor z = body x, sensor x = body y, sensor y = body z
    q_body_to_sensor = Rotation.from_matrix(np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]).T).as_quat()
    trajectory = mounted(samples, q_body_to_sensor)
    assert axes(trajectory.q_icrs_to_sensor(0))[2] == pytest.approx([0, 1, 0])
    assert trajectory.rate_sensor(0) == pytest.approx([0, 0, 0.1])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "an empty file"),
        ("t_s,q_x,q_y,q_z\n0,0,0,0", "line 1: there is no column q_w"),
        ("t_s,utc,q_x,q_y,q_z,q_w\n", "line 1: allowed is one column of time"),
        ("q_x,q_y,q_z,q_w\n0,0,0,1", "one column of time"),
        ("t_s,q0,q1,q2,q3\n", "column 'q0'; allowed are t_s, utc, q_x"),
        ("t_s,q_x,q_x,q_y,q_z,q_w\n", "column q_x twice"),
        ("t_s,q_x,q_y,q_z,q_w,x_km\n", "there is no column y_km"),
        ("t_s,q_x,q_y,q_z,q_w\n0,0,0,0", "line 2: 4 values; allowed are 5"),
        ("t_s,q_x,q_y,q_z,q_w\n0,0,0,0,1\n#\n1,0,0,x,1", "line 4: q_z: found 'x'"),
        ("t_s,q_x,q_y,q_z,q_w\n0,0,0,0,nan", "line 2: q_w: found 'nan'"),
        ("t_s,q_x,q_y,q_z,q_w\n0,0,0,0,0", "line 2: q_icrs_to_sensor.*not all zero"),
        ("t_s,q_x,q_y,q_z,q_w\n1e12,0,0,0,1", "line 2: t_s"),
        ("utc,q_x,q_y,q_z,q_w\n2026-13-01T00:00:00,0,0,0,1", "line 2: .*is no date"),
        ("utc,q_x,q_y,q_z,q_w\nyesterday,0,0,0,1", "line 2: 'yesterday' is no date in UTC"),
    ],
)
def test_wrong_csv_is_told_by_its_line(text, says):
    with pytest.raises(ValueError, match=says):
        samples_of_csv(text, START)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (["0,0,0,0,1"], "1 attitudes; allowed are 2"),
        (["0,0,0,0,1", "0,0,0,0,1"], "allowed are times after"),
        (["1,0,0,0,1", "0,0,0,0,1"], "allowed are times after"),
    ],
)
def test_attitudes_that_do_not_follow(rows, says):
    samples = samples_of_csv("\n".join(["t_s,q_x,q_y,q_z,q_w", *rows]), START)
    with pytest.raises(ValueError, match=says):
        mounted(samples, [0, 0, 0, 1])


@given(st.text(max_size=200) | st.text("t_sq_xyzw,0123456789.-e\n", max_size=200))
def test_any_text_gives_samples_or_one_error(text):
    with contextlib.suppress(ValueError):
        samples_of_csv(text, START)


# -- dates


@pytest.mark.parametrize(
    ("text", "scale", "after_ns"),
    [
        ("2026-01-15T00:00:00", "UTC", 0),
        ("2026-01-15T00:00:00Z", "UTC", 0),
        ("2026-01-15 00:00:00.000000001", "UTC", 1),
        ("2026-015T00:00:01.5", "UTC", 3 * S // 2),
        ("2026-01-15T00:00:37", "TAI", 0),  # 37 leap seconds
        ("2026-01-15T00:01:09.184", "TT", 0),
        ("2026-01-15T00:00:18", "GPS", 0),
    ],
)
def test_dates(text, scale, after_ns):
    assert tai_ns_of(text, scale) - START == after_ns


def test_a_leap_second_is_one_of_its_own():
    before, leap, after = (
        tai_ns_of(t, "UTC") for t in ("2016-12-31T23:59:59", "2016-12-31T23:59:60", "2017-01-01T00:00:00")
    )
    assert (leap - before, after - leap) == (S, S)


@pytest.mark.parametrize(
    ("text", "scale"),
    [("2026-02-30T00:00:00", "UTC"), ("2026-01-15T25:00:00", "UTC"), ("2026-000T00:00:00", "UTC"),
     ("2026-01-15", "UTC"), ("2026-01-15T00:00:00Z", "TAI"), ("2026-01-15T00:00:00", "UT1"), ("", "UTC"),
     ("٢٠٢٦-01-15T00:00:00", "UTC"), ("2026-01-15T00:00:00+01:00", "UTC")],
)  # fmt: skip
def test_no_dates(text, scale):
    with pytest.raises(ValueError, match=r"allowed|is no date"):
        tai_ns_of(text, scale)


# -- AEM

AEM_1 = """CCSDS_AEM_VERS = 1.0
CREATION_DATE = 2026-01-01T00:00:00
ORIGINATOR = A TEST

META_START
COMMENT by hand
OBJECT_NAME = SAT
OBJECT_ID = 2026-001A
CENTER_NAME = EARTH
REF_FRAME_A = ICRF
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = UTC
START_TIME = 2026-01-15T00:00:00
STOP_TIME = 2026-01-15T00:00:02
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = LAST
META_STOP
DATA_START
2026-01-15T00:00:00.0 0 0 0 1
2026-01-15T00:00:02.0 0 0 0.70710678118654752 0.70710678118654752
DATA_STOP
"""
AEM_2 = (
    AEM_1.replace("VERS = 1.0", "VERS = 2.0")
    .replace("ATTITUDE_DIR = A2B\n", "")
    .replace("QUATERNION_TYPE = LAST\n", "ANGVEL_FRAME = SC_BODY_1\n")
    .replace("= QUATERNION\n", "= QUATERNION/ANGVEL\n")
    .replace("0 0 0 1\n", "0 0 0 1 0 0 45\n")
    .replace("0.70710678118654752 0.70710678118654752\n", "0.70710678118654752 0.70710678118654752 9 0 45\n")
)


def xml_of(version: str) -> str:
    """The same message in XML, by hand."""
    states = {
        "1.0": "<quaternionState><EPOCH>{epoch}</EPOCH><quaternion><QC>{c}</QC><Q1>0</Q1><Q2>0</Q2>"
        "<Q3>{z}</Q3></quaternion></quaternionState>",
        "2.0": "<quaternionAngVel><EPOCH>{epoch}</EPOCH><quaternion><Q1>0</Q1><Q2>0</Q2><Q3>{z}</Q3>"
        '<QC>{c}</QC></quaternion><angVel><ANGVEL_X units="deg/s">{x}</ANGVEL_X>'
        '<ANGVEL_Y units="deg/s">0</ANGVEL_Y><ANGVEL_Z units="deg/s">45</ANGVEL_Z></angVel>'
        "</quaternionAngVel>",
    }[version]
    more = {
        "1.0": ("<ATTITUDE_DIR>A2B</ATTITUDE_DIR>", "<ATTITUDE_TYPE>quaternion</ATTITUDE_TYPE>"
                "<QUATERNION_TYPE>LAST</QUATERNION_TYPE>"),
        "2.0": ("", "<ATTITUDE_TYPE>QUATERNION/ANGVEL</ATTITUDE_TYPE><ANGVEL_FRAME>SC_BODY_1</ANGVEL_FRAME>"),
    }[version]  # fmt: skip
    rows = (("2026-01-15T00:00:00", 1, 0, 0), ("2026-01-15T00:00:02", EAST[3], EAST[2], 9))
    data = "".join(
        f"<attitudeState>{states.format(epoch=epoch, c=c, z=z, x=x)}</attitudeState>"
        for epoch, c, z, x in rows
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><aem id="CCSDS_AEM_VERS" version="{version}"><header>'
        "<CREATION_DATE>2026-01-01T00:00:00</CREATION_DATE><ORIGINATOR>A TEST</ORIGINATOR></header>"
        "<body><segment><metadata><OBJECT_NAME>SAT</OBJECT_NAME><OBJECT_ID>2026-001A</OBJECT_ID>"
        "<CENTER_NAME>EARTH</CENTER_NAME><REF_FRAME_A>ICRF</REF_FRAME_A><REF_FRAME_B>SC_BODY_1</REF_FRAME_B>"
        f"{more[0]}<TIME_SYSTEM>UTC</TIME_SYSTEM><START_TIME>2026-01-15T00:00:00</START_TIME>"
        f"<STOP_TIME>2026-01-15T00:00:02</STOP_TIME>{more[1]}</metadata><data>{data}</data></segment></body></aem>"
    )


@pytest.mark.parametrize(
    "text", [AEM_1, AEM_2, xml_of("1.0"), xml_of("2.0")], ids=["1", "2", "1 XML", "2 XML"]
)
def test_aem(text):
    assert is_aem(text)
    first, last = samples_of_aem(text, START)
    assert (first.t_ns, last.t_ns) == (0, 2 * S)
    assert first.q_icrs_to_sensor == pytest.approx((0, 0, 0, 1))
    assert last.q_icrs_to_sensor == pytest.approx(EAST)
    assert axes(last.q_icrs_to_sensor)[0] == pytest.approx([0, 1, 0])


@pytest.mark.parametrize("text", [AEM_2, xml_of("2.0")], ids=["KVN", "XML"])
def test_angular_velocities(text):
    _, last = samples_of_aem(text, START)
    assert last.rate_rad_s == pytest.approx(np.radians([9, 0, 45]))
    inertial = text.replace("ANGVEL_FRAME = SC_BODY_1", "ANGVEL_FRAME = ICRF").replace(
        "<ANGVEL_FRAME>SC_BODY_1", "<ANGVEL_FRAME>ICRF"
    )
    _, last = samples_of_aem(inertial, START)
    assert last.rate_rad_s == pytest.approx(np.radians([0, -9, 45]))  # ICRS x is minus the body's y then


def test_conventions_of_version_1_are_heeded():
    scalar_first = (
        AEM_1.replace("= LAST", "= FIRST")
        .replace(" 0 0 0 1\n", " 1 0 0 0\n")
        .replace(
            " 0 0 0.70710678118654752 0.70710678118654752", " 0.70710678118654752 0 0 0.70710678118654752"
        )
    )
    assert samples_of_aem(scalar_first, START) == samples_of_aem(AEM_1, START)
    turned = AEM_1.replace("A2B", "B2A")
    assert axes(samples_of_aem(turned, START)[1].q_icrs_to_sensor)[0] == pytest.approx([0, -1, 0])
    swapped = turned.replace("A = ICRF", "A = SC_BODY_1").replace("B = SC_BODY_1", "B = ICRF")
    assert samples_of_aem(swapped, START)[1].q_icrs_to_sensor == pytest.approx(EAST)


def test_frame_b_may_be_the_inertial_one_in_version_2():
    swapped = AEM_2.replace("A = ICRF", "A = SC_BODY_1").replace("B = SC_BODY_1", "B = ICRF")
    _, last = samples_of_aem(swapped, START)
    assert axes(last.q_icrs_to_sensor)[0] == pytest.approx([0, -1, 0])
    assert last.rate_rad_s == pytest.approx(np.radians([-9, 0, -45]))  # of ICRF relative to the body, told


def test_the_mean_frame_of_j2000_is_23_mas_off():
    sample = samples_of_aem(AEM_1.replace("ICRF", "EME2000"), START)[0]
    turn = Rotation.from_quat(sample.q_icrs_to_sensor).as_rotvec()
    # IERS Conventions (2010), 5.4.4: offsets of the pole xi -16.617, eta -6.819 mas, of the origin -14.6 mas;
    # the frame turns by (-eta, xi, d alpha)
    assert turn / MAS == pytest.approx([6.819, -16.617, -14.6], abs=0.05)


@pytest.mark.parametrize(("scale", "late_s"), [("TAI", -37), ("TT", -69.184), ("GPS", -18)])
def test_time_systems(scale, late_s):
    sample = samples_of_aem(AEM_1.replace("TIME_SYSTEM = UTC", f"TIME_SYSTEM = {scale}"), START)[0]
    assert sample.t_ns == pytest.approx(late_s * S)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("TYPE = QUATERNION\n", "TYPE = SPIN\n", "SPIN"),
        ("A = ICRF", "A = TEME", "REF_FRAME_A = TEME.*allowed is one of ICRF"),
        ("B = SC_BODY_1", "B = EME2000", "allowed is one of"),
        ("B = SC_BODY_1", "B = LVLH", "frame LVLH"),
        ("= UTC", "= UT1", "TIME_SYSTEM = UT1; allowed are UTC, TAI, TT, GPS|UT1"),
        ("0 0 0 1\n", "0 0 0 2\n", "attitude 1: quaternion .*length 1"),
        ("0 0 0 1\n", "0 0 0\n", "no AEM that can be read|attitude 1"),
        ("2026-01-15T00:00:00.0", "2026-15-15T00:00:00.0", "attitude 1: .*is no date"),
        ("AEM_VERS = 1.0", "AEM_VERS = 9.0", "no AEM that can be read"),
        ("META_START", "", "."),
    ],
)
def test_what_is_not_supported_is_refused_by_name(old, new, says):
    assert old in AEM_1
    with pytest.raises(ValueError, match=says):
        samples_of_aem(AEM_1.replace(old, new), START)


def test_two_segments_are_not_joined():
    second = AEM_1[AEM_1.index("META_START") :]
    with pytest.raises(ValueError, match="2 segments"):
        samples_of_aem(AEM_1 + second, START)


def test_xml_with_a_document_type_is_refused():
    text = xml_of("2.0").replace("?><aem", '?><!DOCTYPE aem [<!ENTITY x SYSTEM "file:///etc/hostname">]><aem')
    with pytest.raises(ValueError, match="document type"):
        samples_of_aem(text, START)


@given(st.integers(0, len(AEM_2)), st.text(max_size=20))
def test_a_damaged_aem_gives_samples_or_one_error(at, text):
    with contextlib.suppress(ValueError):
        samples_of_aem(AEM_2[:at] + text + AEM_2[at + len(text) :], START)


def test_without_the_package_it_is_told_what_to_install():
    program = (
        "import sys; sys.modules['ccsds_ndm'] = None\n"
        "from st_emulator.world.aem import samples_of_aem\n"
        f"samples_of_aem({AEM_1!r}, 0)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert run.stderr.splitlines()[-1].endswith("pip install 'st-emulator[aem]'")
