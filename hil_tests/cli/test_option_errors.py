"""Options that cannot be: status 2 and one line; of typer's own, status 2 and its box."""

from __future__ import annotations

import json
import os
import pty
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from st_emulator.links.pty import PtyLink
from st_emulator.links.serial_port import SerialLink

COLUMNS, ROWS = 752, 480
FAST = ("--speed", "max", "--seconds", "0.1")


def grey(path: Path, columns: int = COLUMNS, rows: int = ROWS) -> Path:
    Image.fromarray(np.zeros((rows, columns), np.uint16)).save(path)
    return path


# -- run: speed and links


@pytest.mark.parametrize("link", ["pty", "serial:/dev/ttyS0"])
def test_speed_with_a_live_obc(link, refused):
    refused("run", "roja1", "--speed", "max", "--link", link, says=("--speed max", link, "own time", "none"))
    refused("run", "roja1", "--speed", "2", "--link", link, says=("--speed 2", "only --speed 1"))


@pytest.mark.parametrize("speed", ["abc", "0", "-1", "1001", "nan", "inf", ""])
def test_speed_that_is_none(speed, refused):
    refused("run", "roja1", "--speed", speed, says=(f"--speed {speed}:", "0.01 to 1000", "max"))


def test_speed_max_without_an_end(refused):
    refused("run", "roja1", "--speed", "max", says=("needs an end", "--seconds", "duration_s"))


def test_seconds_without_end(refused):
    refused("run", "roja1", "--speed", "max", "--seconds", "inf", says=("--seconds inf", "finite"))


@pytest.mark.parametrize(
    ("link", "says"),
    [
        ("usb", ("'usb'", "pty:PATH", "serial:DEVICE@BAUD")),
        ("pty:", ("path is missing", "pty:PATH")),
        ("serial:", ("device is missing",)),
        ("serial:/dev/ttyS0@fast", ("'fast'", "300 to 4000000")),
        ("serial:/dev/no-such-port", ("/dev/no-such-port", "no such device")),
        ("serial:/dev/null", ("/dev/null", "no serial port")),
        ("pty:/no-such-folder/unit", ("/no-such-folder", "does not exist")),
    ],
)
def test_links(link, says, refused):
    refused("run", "roja1", "--link", link, says=says)


def test_busy_port(refused):
    master, slave = pty.openpty()
    device = os.ttyname(slave)
    try:
        with SerialLink(device, 115200):
            refused("run", "roja1", "--link", f"serial:{device}", says=(device, "busy"))
    finally:
        os.close(master)
        os.close(slave)


def test_pty_path_that_is_a_file(refused, tmp_path):
    path = tmp_path / "tracker"
    path.write_text("mine")
    refused("run", "roja1", "--link", f"pty:{path}", says=(str(path), "name another path"))
    assert path.read_text() == "mine"


def test_pty_path_of_a_running_emulator(refused, tmp_path):
    with PtyLink(tmp_path / "tracker"):
        refused("run", "roja1", "--link", f"pty:{tmp_path}/tracker", says=("running emulator",))
        assert (tmp_path / "tracker").is_symlink()


# -- recorded frames


def test_frames_of_the_wrong_size(refused, tmp_path):
    frame = grey(tmp_path / "a.png", 12, 10)
    wanted = ("a.png", "12 x 10", "752 x 480")
    refused("run", "roja1", "--frames", tmp_path, *FAST, says=wanted)
    refused("solve", frame, says=wanted)


def test_no_frames(refused, tmp_path):
    (tmp_path / "readme.txt").write_text("no frame")
    refused("run", "roja1", "--frames", tmp_path, *FAST, says=(str(tmp_path), "without frames", ".png"))
    refused("run", "roja1", "--frames", tmp_path / "none", *FAST, says=("none", "no such file"))
    refused("solve", tmp_path / "none.png", says=("none.png", "no such file"))
    refused("solve", tmp_path / "readme.txt", says=("readme.txt", ".txt", ".fits"))


@pytest.mark.parametrize("name", ["broken.png", "broken.tif", "broken.fits"])
def test_broken_frame(name, refused, tmp_path):
    whole = grey(tmp_path / "whole.png").read_bytes()
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / name).write_bytes(whole[: len(whole) // 2])
    refused("run", "roja1", "--frames", folder, *FAST, says=(name, "cannot be read"))
    refused("solve", folder / name, says=(name, "cannot be read"))


# -- files that cannot be written


@pytest.mark.parametrize("option", ["--journal", "--truth"])
def test_output_that_cannot_be_written(option, refused, tmp_path):
    refused("run", "roja1", *FAST, option, tmp_path, says=(f"{option} {tmp_path}", "directory"))
    path = tmp_path / "none/file"
    refused("run", "roja1", *FAST, option, path, says=(f"{option} {path}", "No such file"))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full, the disk that is always full")
@pytest.mark.parametrize("option", ["--journal", "--truth"])
def test_full_disk(option, refused, tmp_path):
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        "[[telecommands]]\nat_s = 0.6\nname = 'function'\nfields = {function_id = 'START_ACQUISITION'}\n"
    )
    arguments = ("--scenario", scenario, "--speed", "max", "--seconds", "1.5", "--quiet")
    refused("run", "roja1", *arguments, option, "/dev/full", says=(f"{option} /dev/full", "No space left"))


def test_journal_and_truth_in_one_file(refused, tmp_path):
    path = tmp_path / "both"
    refused("run", "roja1", *FAST, "--journal", path, "--truth", path, says=("--truth", "journal"))


def test_store_that_is_none(refused, tmp_path):
    refused("run", "roja1", *FAST, "--store", tmp_path, says=(str(tmp_path), "folder"))
    (tmp_path / "file").write_text("")
    refused("run", "roja1", *FAST, "--store", tmp_path / "file/store", says=("file/store",))


@pytest.mark.parametrize(
    "arguments",
    [
        ("campaign", "lost-in-space", "--n", "1"),
        ("solve", "frame.png"),
        ("replay", "journal.jsonl"),
        ("units",),
        ("demo",),
    ],
)
def test_figures_that_cannot_be_written_are_told_before_the_work(arguments, refused, tmp_path):
    """The line is all that appears: no table of a campaign that ran in vain, no missing input first."""
    refused(*arguments, "--json", tmp_path / "none/out.json", says=("--json", "none/out.json"))
    refused(*arguments, "--json", tmp_path, says=("--json", str(tmp_path)))


def test_picture_that_cannot_be_written(refused, tmp_path):
    frame = grey(tmp_path / "dark.png")
    refused("solve", frame, "--picture", tmp_path / "out.xyz", says=("out.xyz", ".png"))
    refused("solve", frame, "--picture", tmp_path / "none/out.png", says=("none/out.png",))


def test_demo_folder_that_is_none(refused, tmp_path):
    (tmp_path / "file").write_text("")
    refused("demo", "--out", tmp_path / "file", says=("--out", "file"))
    refused("demo", "--out", tmp_path / "file/inside", says=("--out", "file"))


def test_replay_writes_where_it_can(refused, command, tmp_path):
    journal = tmp_path / "journal.jsonl"
    assert command("run", "roja1", *FAST, "--journal", journal, "--store", "none").status == 0
    refused("replay", journal, "--write", tmp_path, says=("--write", str(tmp_path)))


# -- journals


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", ("not a journal",)),
        ("hello\n", ("line 1", "not a JSON object")),
        ("[]\n", ("line 1", "not a JSON object")),
        ('{"format": "other"}\n', ("not a journal", "st-emulator journal 1")),
        ('{"format": "st-emulator journal 1"}\n', ("line 1", "damaged", "unit")),
        ('{"format": "st-emulator journal 1", "unit": {}, "scenario": {}}\n', ("unit", "missing")),
    ],
)
def test_bad_journal(text, says, refused, tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text(text)
    refused("replay", path, says=(str(path), *says))


def test_journal_with_a_bad_line(refused, command, tmp_path):
    """Its first line is good; what comes behind it is read while it is replayed."""
    path = tmp_path / "journal.jsonl"
    assert command("run", "roja1", *FAST, "--journal", path, "--store", "none").status == 0
    first = path.read_text().split("\n", 1)[0]
    for text, says in [
        ('x\n{"t_ns": 1, "tx": "00"}\n', ("line 2", "JSON")),
        ('{"t_ns": 1}\n', ("line 2", "rx or tx")),
        ('{"t_ns": "x", "tx": "00"}\n', ("line 2", "t_ns")),
        ('{"t_ns": 1, "tx": "0"}\n', ("line 2", "hexadecimal")),
        ('{"t_ns": 1, "tx": 5}\n', ("line 2", "hexadecimal")),
        ("3\n{}\n", ("line 2", "JSON object")),
    ]:
        path.write_text(f"{first}\n{text}")
        refused("replay", path, says=(str(path), *says))


def test_journal_that_is_not_there_or_no_text(refused, tmp_path):
    refused("replay", tmp_path / "none", says=("none", "No such file", "journal"))
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    refused("replay", tmp_path / "binary", says=("binary", "not a text file"))


def test_journal_with_a_damaged_header(refused, command, tmp_path):
    path = tmp_path / "journal.jsonl"
    assert command("run", "roja1", *FAST, "--journal", path, "--store", "none").status == 0
    header, *rest = path.read_text().splitlines()
    for change, says in (
        ({"seed": "x"}, "damaged"),
        ({"store": {"parameters": {}}}, "damaged"),
        ({"store": None}, "damaged"),
        ({"frames": ["/none/a.png"]}, "/none/a.png"),
        ({"scenario": {"seed": -1}}, "seed"),
    ):
        path.write_text("\n".join([json.dumps(json.loads(header) | change), *rest]) + "\n")
        refused("replay", path, says=(says,))


# -- the rest


def test_unknown_campaign(refused):
    refused("campaign", "nosuch", says=("nosuch", "earth-rate", "lost-in-space", "accuracy"))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("zy3-table3", "--unit", "roja1"), ("--unit roja1", "zy3 alone")),
        (("accuracy", "--plot", "out.png"), ("--plot", "accuracy", "zy3-table3")),
        (("zy3-table3", "--plot", "out.xyz"), ("--plot", "out.xyz", ".png")),
        (("zy3-table3", "--plot", "none/out.png"), ("--plot", "none/out.png")),
        (("zy3-table3", "--results", "none/out.jsonl"), ("--results", "none/out.jsonl")),
        (("zy3-table3", "--results", "."), ("--results", "folder")),
        (("zy3-table3", "--results", "x.jsonl", "--restart"), ("--restart", "--results")),
        (("zy3-table3", "--workers", "2", "--dask", "tcp://127.0.0.1:1"), ("--workers", "--dask")),
        (("earth-rate", "--dask", "tcp://127.0.0.1:1"), ("--dask", "earth-rate")),
        (("star-quadruples", "--results", "x.jsonl"), ("--results", "star-quadruples")),
        (("false-stars", "--n", "1", "--dask", "nonsense://x"), ("--dask nonsense://x",)),
    ],
)
def test_options_that_a_campaign_has_no_use_for(arguments, says, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused("campaign", *arguments, says=says)
    assert not list(tmp_path.glob("*.jsonl"))


@pytest.mark.parametrize(
    "arguments",
    [
        ("run",),
        ("run", "roja1", "--seed", "-1"),
        ("run", "roja1", "--seed", "x"),
        ("run", "roja1", "--seconds", "0"),
        ("run", "roja1", "--seconds", "nan"),
        ("run", "roja1", "--hold", "0"),
        ("run", "roja1", "--nosuch"),
        ("demo", "--seconds", "5"),
        ("demo", "--seconds", "nan"),
        ("campaign", "accuracy", "--n", "0"),
        ("campaign", "accuracy", "--workers", "0"),
        ("solve",),
        ("nosuch",),
    ],
)
def test_typers_own(arguments, command):
    outcome = command(*arguments)
    assert (outcome.status, outcome.out) == (2, "")
    assert "Usage: st-emulator" in outcome.err
    assert "Traceback" not in outcome.err
