"""`st-emulator obc`: commands, scripts, shell, live view, exit statuses, JSON."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner, Result

from hil_tests.obc.test_live_view import SIGMA_3_4_12_ARCSEC
from st_emulator.links import MemoryLink
from st_emulator.obc import Obc, Recorder, SteppedReader
from st_emulator.obc.cli import obc_app
from st_emulator.obc.commands import COMMANDS, CommandError, parse_line
from st_emulator.obc.session import Session
from st_emulator.obc.shell import _Shell
from st_emulator.units.profile import load_unit

Run = Callable[..., Result]


@pytest.fixture
def run(unit: Any, link_pair: tuple[MemoryLink, MemoryLink]) -> Run:
    """The command line with a fake unit on the other end; `run.asked` is what it would have connected to."""

    def connect(link: str, *, record: Path | None = None, **options: Any) -> Obc:
        asked.append({"link": link, **options})
        recorder = None if record is None else Recorder(record)
        apid = options.get("apid", 0x123)
        source_id = options.get("source_id", 0)
        return Obc(
            link_pair[1], apid=apid, source_id=source_id, recorder=recorder, reader=SteppedReader(unit.step)
        )

    asked: list[dict[str, Any]] = []

    def invoke(*arguments: str, typed: str | None = None) -> Result:
        return CliRunner().invoke(obc_app, list(arguments), input=typed, obj=connect)

    invoke.asked = asked  # type: ignore[attr-defined]
    unit.answer((17, 1), lambda request: unit.send(17, 2))
    unit.answer((3, 27), unit.status)
    return invoke


def commands(*lines: str) -> list[str]:
    return [word for line in lines for word in ("--command", line)]


def test_commands_run_in_order(run: Run, unit: Any) -> None:
    unit.answer((8, 1))
    result = run("--link", "pty:/x", *commands("ping", "standby"))
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [
        "> ping",
        "pong after 1.0 ms",
        "> standby",
        "function GO_STANDBY TC[8,1] (APID 0x123, count 1): verified after 0.001 s",
    ]
    assert [request.type for request in unit.requests] == [(17, 1), (8, 1)]
    assert run.asked == [{"link": "pty:/x"}]  # type: ignore[attr-defined]


def test_a_script_that_holds(run: Run, unit: Any, tmp_path: Path) -> None:
    unit.mode = 4
    unit.attitude(frame=9, after_ms=5)
    script = tmp_path / "check.txt"
    script.write_text(
        "# a comment\n\nping  # and another\nexpect mode == TRACKING\nexpect attitude.frame_index >= 9\n"
    )
    result = run("--script", str(script), "--json", str(tmp_path / "out.json"))
    assert result.exit_code == 0, result.output
    out = json.loads((tmp_path / "out.json").read_text())
    assert out["checks"] == [
        {"name": "ping", "value": True, "target": "done", "unit": "", "holds": True},
        {"name": "mode", "value": 4, "target": "== TRACKING", "unit": "", "holds": True},
        {"name": "attitude.frame_index", "value": 9, "target": ">= 9", "unit": "", "holds": True},
    ]
    assert [entry["where"] for entry in out["commands"]] == [f"{script}, line {n}" for n in (3, 4, 5)]
    assert (out["apid"], out["mode"], out["counters"]["telecommands_sent"]) == (0x123, "TRACKING", 2)


def test_an_expectation_that_does_not_hold_is_named_and_the_script_goes_on(
    run: Run, unit: Any, tmp_path: Path
) -> None:
    script = tmp_path / "check.txt"
    script.write_text("expect status.temperature_cdeg > 0\nping\n")
    result = run("--script", str(script), "--json", str(tmp_path / "out.json"))
    assert result.exit_code == 1
    assert result.stderr.splitlines() == [
        f"{script}, line 1: expect status.temperature_cdeg > 0: "
        "status.temperature_cdeg is -250 0.01 degC, expected > 0"
    ]
    assert "pong" in result.stdout
    checks = json.loads((tmp_path / "out.json").read_text())["checks"]
    assert [check["holds"] for check in checks] == [False, True]
    assert checks[0]["value"] == -250


def test_a_command_that_fails_is_named_and_ends_the_script(run: Run, unit: Any, tmp_path: Path) -> None:
    unit.handlers[(8, 1)] = lambda request: unit.fail(request, 2, 7, 4)
    script = tmp_path / "check.txt"
    script.write_text("ping\nself-test\nping\nping\n")
    result = run("--script", str(script), "--json", "-")
    assert result.exit_code == 1
    assert (
        f"{script}, line 2: self-test: function START_SELF_TEST TC[8,1] (APID 0x123, count 1): "
        in result.stderr
    )
    assert "acceptance failed: NOT_ALLOWED_IN_MODE (7), data 4" in result.stderr
    assert f"{script}, line 2: stopped; commands not run: 2" in result.stderr
    out = json.loads(result.stdout)  # nothing else on standard output
    assert [check["holds"] for check in out["checks"]] == [True, False]
    assert len(unit.requests) == 2


def test_a_silent_unit_fails_the_command(run: Run, unit: Any) -> None:
    unit.handlers.clear()
    result = run(*commands("ping"))
    assert result.exit_code == 1
    assert "within 1 s never came: acceptance report, start report, completion report" in result.stderr


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("dance", "dance: no such command; help lists them"),
        ("wait", "wait: write wait SECONDS"),
        ("ping now", "ping: write ping"),
        ("wait soon", "wait: SECONDS is 'soon'; allowed are 0 to 86400"),
        ("wait -1", "allowed are 0 to 86400"),
        ("wait-mode DANCING", "'DANCING' is none of boot, self_test, standby"),
        ("wait-event party", "'party' is none of boot_completed"),
        ("set exposure_us", "write set PARAM VALUE ..."),
        ("set exposure_us 1 2", "every PARAM needs a VALUE"),
        ("set exposure 1", "'exposure' is none of exposure_us"),
        ("set 999 1", "'999' is no parameter"),
        ("set exposure_us many", "exposure_us is 'many'; it is a whole number"),
        ("set magnitude_limit faint", "magnitude_limit is 'faint'; it is a number"),
        ("hk maybe status", "write on, off or now"),
        ("hk off status 3", "only on takes SECONDS"),
        ("hk on weather", "'weather' is none of status, link, timing"),
        ("event sometimes mode_changed", "write on or off"),
        ("image picture.jpg", "picture.jpg is no picture; allowed are .png"),
        ("dump RAM -1 5", "ADDRESS is '-1'"),
        ("load RAM 0 0g", "'0g' is no hexadecimal text"),
        ("send dance", "'dance' is no telecommand; there are"),
        ("send ping x", "'x' is no FIELD=VALUE"),
        ("set-time yesterday", "'yesterday' is no time"),
        ("set-time 2026-05-01T12:00:00", "a time zone is needed"),
        ("raw xyz", "no hexadecimal text"),
        ("expect mode = TRACKING", "'=' is no comparison; allowed are == != < <= > >="),
        ("expect mode == FLYING", "'FLYING' is none of"),
        ("expect attitude.colour == 1", "attitude has no 'colour'; it has frame_index"),
        ("expect weather == 1", "'weather' is nothing to expect; allowed are mode, attitude.FIELD"),
        ("expect status.mode == TRACKING now", "write expect FIELD OP VALUE"),
        ("expect counters.packets > many", "'many' is no number"),
        ("refused NOTHING ping", "'NOTHING' is none of unknown_apid"),
        ("refused CRC dance", "dance: no such command"),
        ('set-time "', "No closing quotation"),
        ("track-from 0 0 0 2", "q_w is '2'; allowed are -1 to 1"),
        ("help dance", "'dance' is no command"),
    ],
)
def test_a_wrong_line_is_refused_before_anything_is_sent(
    run: Run, unit: Any, line: str, message: str
) -> None:
    result = run(*commands("ping", line))
    assert result.exit_code == 2
    assert unit.requests == []
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    with pytest.raises(CommandError):
        parse_line(line)


def test_the_wrong_line_of_a_script_is_named(run: Run, tmp_path: Path) -> None:
    script = tmp_path / "check.txt"
    script.write_text("ping\n\ndance\n")
    result = run("--script", str(script))
    assert result.exit_code == 2
    assert result.stderr == f"st-emulator obc: {script}, line 3: dance: no such command; help lists them\n"


def test_wrong_arguments_are_one_line_and_status_2(run: Run, tmp_path: Path) -> None:
    for arguments, message in [
        (["--script", str(tmp_path / "none")], "cannot be read: No such file"),
        (["--script", "x", "--watch"], "exclude each other"),
        (["--unit", "no-such-unit", *commands("ping")], "no unit 'no-such-unit'"),
    ]:
        result = run(*arguments)
        assert result.exit_code == 2
        assert message in result.stderr
        assert len(result.stderr.splitlines()) == 1
    assert run("--apid", "9999").exit_code == 2


def test_a_link_that_cannot_be_opened_is_status_2(tmp_path: Path) -> None:
    result = CliRunner().invoke(obc_app, ["--link", f"pty:{tmp_path}/none", *commands("ping")])
    assert result.exit_code == 2
    assert result.stderr.startswith(f"st-emulator obc: pty:{tmp_path}/none: no pseudo-terminal there")
    assert len(result.stderr.splitlines()) == 1


def test_a_folder_with_a_recording_is_status_2(run: Run, tmp_path: Path) -> None:
    (tmp_path / "telemetry.jsonl").write_text("")
    result = run("--record", str(tmp_path), *commands("ping"))
    assert result.exit_code == 2
    assert "holds a recording already" in result.stderr


def test_recording_from_the_command_line(run: Run, tmp_path: Path) -> None:
    assert run("--record", str(tmp_path / "r"), *commands("ping")).exit_code == 0
    assert len((tmp_path / "r" / "telemetry.jsonl").read_text().splitlines()) == 3


def test_the_unit_gives_apid_and_source(run: Run, unit: Any) -> None:
    result = run("--unit", "roja1", *commands("wait 0"))
    assert result.exit_code == 0
    wire = load_unit("roja1").wire
    assert run.asked[0]["apid"] == wire.apid  # type: ignore[attr-defined]
    assert run.asked[0]["baud"] == wire.baud  # type: ignore[attr-defined]


# The shell


def test_the_shell_reads_lines_that_nobody_types(run: Run, unit: Any) -> None:
    result = run(typed="ping\n\nquit\nping\n")
    assert result.exit_code == 0
    assert result.stdout.splitlines() == ["pong after 1.0 ms"]
    assert len(unit.requests) == 1


def test_the_shell_goes_on_after_an_error_and_says_so_at_the_end(run: Run, unit: Any) -> None:
    unit.handlers[(8, 1)] = lambda request: unit.fail(request, 2, 11)
    result = run(typed="dance\nstandby\nping\n")
    assert result.exit_code == 1
    assert "dance: no such command" in result.stderr
    assert "BUSY" in result.stderr
    assert "pong" in result.stdout


def test_the_shell_tells_events_as_they_come(run: Run, unit: Any) -> None:
    unit.event(18, b"", after_ms=5)
    result = run(typed="wait 0.01\nwait 0.01\n")
    assert result.stdout.splitlines() == ["  event info: SHUTDOWN_STARTED"]


def test_the_shell_ends_with_the_link(run: Run, unit: Any) -> None:
    def vanish(now_ns: int) -> None:
        unit.link.close()

    unit.step = vanish
    result = run(typed="ping\nping\n")
    assert result.exit_code == 1
    assert "the other side has closed" in result.stderr
    assert "never came" not in result.stderr


def test_completion_of_commands_and_arguments(run: Run, obc: Obc) -> None:
    shell = _Shell(Session(obc, print, lambda obc, seconds: None), print)
    assert shell.completenames("wait") == ["wait ", "wait-mode ", "wait-event "]
    assert "exposure_us" in shell.completedefault("expo", "set expo", 4, 8)
    assert shell.completedefault("tr", "wait-mode tr", 10, 12) == ["tracking"]


# Single commands


def test_help_lists_every_command(run: Run) -> None:
    lines = run(*commands("help")).stdout.splitlines()[1:]
    assert [line.split()[0] for line in lines] == list(COMMANDS)
    assert len(run(*commands("help expect")).stdout.splitlines()) == 2


def test_status_with_names_and_units(run: Run) -> None:
    lines = [" ".join(line.split()) for line in run(*commands("status")).stdout.splitlines()]
    assert "mode STANDBY" in lines
    assert "uptime_ms 1234 ms" in lines


def test_get_and_set(run: Run, unit: Any) -> None:
    unit.answer((20, 1), lambda request: unit.send(20, 2, b"\x01" + struct.pack(">HI", 1, 100_000)))
    unit.answer((20, 3))
    result = run(*commands("get exposure_us", "set exposure_us 0x10 magnitude_limit 6.5"))
    assert result.exit_code == 0, result.output
    assert " ".join(result.stdout.splitlines()[1].split()) == "exposure_us 100000 us"
    assert unit.requests[1].data == struct.pack(">BHIHf", 2, 1, 16, 5, 6.5)  # 16 us: the unit is to refuse it


def test_refused_holds_only_with_the_right_code(run: Run, unit: Any) -> None:
    unit.handlers[(20, 3)] = lambda request: unit.fail(request, 2, 8, 1)
    setting = "set exposure_us 1"
    result = run(
        *commands(f"refused OUT_OF_RANGE {setting}", f"refused READ_ONLY {setting}", "refused CRC wait 0")
    )
    assert result.exit_code == 1
    assert "refused as expected" in result.stdout
    assert len(result.stderr.splitlines()) == 2
    assert "refused with OUT_OF_RANGE, expected READ_ONLY" in result.stderr
    assert "command 3: refused CRC wait 0: was not refused, expected CRC" in result.stderr


def test_times(run: Run, unit: Any) -> None:
    unit.answer((9, 128))
    assert run(*commands("set-time", "set-time 1958-01-02T00:00:00Z")).exit_code == 0
    assert unit.requests[1].data == struct.pack(">IBH", 86_400 + 10, 0, 0)


def test_waiting(run: Run, unit: Any) -> None:
    unit.event(2, struct.pack(">BBB", 2, 3, 4), after_ms=100)
    unit.event(2, struct.pack(">BBB", 3, 4, 4), after_ms=500)
    result = run(
        *commands("wait-event mode_changed 1", "wait-mode tracking 1", "events", "wait-mode off 0.5")
    )
    assert result.exit_code == 1
    assert "TRACKING after 0.400 s" in result.stdout
    assert result.stdout.count("MODE_CHANGED from_mode=STANDBY") == 2
    assert "mode OFF: did not come within 0.5 s; the mode is TRACKING" in result.stderr


def test_modes_and_housekeeping(run: Run, unit: Any) -> None:
    for kind in [(8, 1), (3, 5), (3, 6), (3, 31), (5, 5), (5, 6)]:
        unit.answer(kind)
    lines = ["acquire", "track-from 0 0 0 1", "shutdown", "clear-counters", "restore-defaults"]
    lines += ["hk on timing 0.5", "hk off timing", "hk now status", "event off frame_overran", "event on 4"]
    assert run(*commands(*lines)).exit_code == 0
    functions = [request.data[0] for request in unit.requests if request.type == (8, 1)]
    assert functions == [2, 11, 8, 9, 10]
    assert unit.requests[1].data[1:] == struct.pack(">4d", 0, 0, 0, 1)


def test_memory(run: Run, unit: Any, wire: Any, tmp_path: Path) -> None:
    def dump(request: Any) -> None:
        data = b"\xc0STAR" * 4
        unit.send(6, 6, request.data[:5] + struct.pack(">H", 20) + data + struct.pack(">H", wire.crc16(data)))

    unit.answer((6, 5), dump)
    unit.answer((6, 2))
    unit.answer((6, 9), lambda request: unit.send(6, 10, request.data + b"\x12\x34"))
    file = tmp_path / "dump.bin"
    result = run(
        *commands("dump RAM 0x100 20", f"dump RAM 0x100 20 {file}", "load ram 0 00ff", "check ram 0 16")
    )
    assert result.exit_code == 0, result.output
    assert "00000100  c0 53 54 41 52 c0 53 54 41 52 c0 53 54 41 52 c0  .STAR.STAR.STAR." in result.stdout
    assert file.read_bytes() == b"\xc0STAR" * 4
    assert "CRC-16 0x1234" in result.stdout


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy"])
def test_an_image_file_holds_every_bit(run: Run, unit: Any, wire: Any, tmp_path: Path, suffix: str) -> None:
    pixels = np.array([[0, 1, 65_535], [256, 4095, 40_000]], dtype=np.uint16)
    body = pixels.astype(">u2").tobytes()

    def handle(request: Any) -> None:
        if request.data[0] == 6:
            header = (
                struct.pack(">IHHBB", 1, 3, 2, 16, 0) + wire.CUC + struct.pack(">IH", 1, wire.crc16(body))
            )
            unit.send(13, 1, request.data[1:3] + b"\x00\x01" + header + body)
        unit.complete(request)

    unit.handlers[(8, 1)] = handle
    file = tmp_path / f"image{suffix}"
    result = run(*commands(f"image {file}"))
    assert result.exit_code == 0, result.output
    assert f"frame 1, 3 x 2 pixels in {file}" in result.stdout
    read = np.load(file) if suffix == ".npy" else np.array(Image.open(file))
    assert np.array_equal(read, pixels)


def test_anything_can_be_sent(run: Run, unit: Any, wire: Any) -> None:
    unit.answer((3, 5))
    result = run(*commands("send hk_enable structure_ids=status,timing", "send hk_enable structure_ids=99"))
    assert result.exit_code == 0, result.output
    assert [request.data for request in unit.requests] == [b"\x02\x01\x03", b"\x01\x63"]


def test_raw_octets(run: Run, unit: Any, link_pair: tuple[MemoryLink, MemoryLink]) -> None:
    sent: list[bytes] = []
    unit.step = lambda now_ns: sent.append(unit.link.read())
    assert run(*commands("raw c0 DB", "frame c0 01", "wait 0.001")).exit_code == 0
    assert b"".join(sent) == b"\xc0\xdb" + b"\xc0\xdb\xdc\x01\xc0"


@pytest.mark.parametrize(
    ("expectation", "holds"),
    [
        ("attitude.valid == 1", True),
        ("attitude.reasons == TOO_FEW_STARS|NO_MATCH", False),
        ("attitude.mode != LOST_IN_SPACE", True),
        ("attitude.ra_deg < 1", True),
        ("attitude.dec_deg >= 89.999", True),
        ("attitude.mid_exposure_time == 2000000000.5", True),
        ("status.frames_late <= 0", False),
        ("counters.crc_errors == 0", True),
        ("counters.packets > 1000", False),
        ("parameter.exposure_us == 100000", True),
    ],
)
def test_expectations(run: Run, unit: Any, expectation: str, holds: bool) -> None:
    unit.answer((20, 1), lambda request: unit.send(20, 2, b"\x01" + struct.pack(">HI", 1, 100_000)))
    unit.attitude(after_ms=1)
    assert run(*commands(f"expect {expectation}")).exit_code == (0 if holds else 1)


def test_an_expectation_looks_at_what_is_fresh(run: Run, unit: Any) -> None:
    unit.attitude(frame=1, after_ms=1)
    unit.attitude(frame=2, after_ms=4000)
    assert run(*commands("wait 3", "expect attitude.frame_index == 2")).exit_code == 0


@pytest.mark.parametrize(
    ("older", "rest"), [(False, ", 1 sigma x 3.00  y 4.00  z 12.00 arcsec/s"), (True, "")]
)
def test_the_command_attitude_shows_the_rate(run: Any, unit: Any, older: bool, rest: str) -> None:
    unit.attitude(rate=(0.0, 0.0, 0.017453292), rate_covariance=SIGMA_3_4_12_ARCSEC, older=older, after_ms=1)
    result = run(*commands("attitude"))
    assert result.exit_code == 0
    assert f"  rate x +0.00000  y +0.00000  z +1.00000 deg/s{rest}\n" in result.output


def test_what_an_older_unit_does_not_tell_cannot_be_expected(run: Any, unit: Any) -> None:
    unit.attitude(older=True, after_ms=1)
    result = run(*commands("expect attitude.rate_covariance_xx < 1"))
    assert result.exit_code == 1
    said = "the unit is an older one: its attitude reports have no rate_covariance_xx"
    assert said in result.output.replace("\n", " ")


def test_watch_from_a_script(run: Run, unit: Any) -> None:
    unit.attitude(after_ms=100)
    result = run(*commands("watch 0.5"))
    assert result.exit_code == 0
    assert len(result.stdout.splitlines()) == 2
