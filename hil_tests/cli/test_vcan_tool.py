"""tools/vcan: what a command finds in its guest, what of it comes back, and that nothing is left of it.

Each guest takes two seconds to boot, so that one command looks at many things.
"""

from __future__ import annotations

import importlib.util
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from hil_tests.conftest import has_vcan0

TOOL = Path(__file__).parents[2] / "tools/vcan"
PARTS = TOOL.with_name("vcan_guest")
WANTED = ["linux.uml", "ip", "insmod", "candump"]
PATIENCE_S = 200.0  # only bounds a hang
OUT_BYTES, ERR_BYTES = 1_000_003, 300_001

in_a_guest = pytest.mark.skipif(
    has_vcan0(), reason="this computer has a vcan0: commands run with it and not in a guest"
)


def vcan(*arguments: str | Path, **options: object) -> subprocess.CompletedProcess[bytes]:
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    return subprocess.run([TOOL, *arguments], timeout=PATIENCE_S, **streams | options)  # type: ignore[call-overload]


@pytest.fixture(scope="module", autouse=True)
def installed() -> None:
    """Nothing of an installation is in what the commands below say."""
    assert part("packages").require_packages(WANTED) is None


def part(name: str) -> ModuleType:
    specification = importlib.util.spec_from_file_location(f"vcan_guest_{name}", PARTS / f"{name}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


# -- what a command finds


@pytest.fixture
def outside() -> Iterator[Path]:
    """A folder outside /tmp, where a command in the guest may write everywhere."""
    folder = Path(tempfile.mkdtemp(dir="/var/tmp"))
    yield folder
    shutil.rmtree(folder)


SURROUNDINGS = r"""
import json, os, pathlib, sys
import can
def tried(path):
    try:
        pathlib.Path(path).write_text("written")
    except OSError as error:
        return os.strerror(error.errno)
    return "written"
with can.Bus("vcan0", "socketcan", fd=True) as one, can.Bus("vcan0", "socketcan", fd=True) as two:
    one.send(can.Message(arbitration_id=0x123, data=bytes(64), is_fd=True, is_extended_id=False))
    frame = two.recv(10)
home, runtime = os.environ["HOME"], os.environ["XDG_RUNTIME_DIR"]
print(json.dumps({
    "frame": [frame.arbitration_id, len(frame.data)],
    "arguments": sys.argv[2:],
    "odd": os.environ["ODD"],
    "cwd": os.getcwd(),
    "stdin": sys.stdin.read(),
    "terminals": [os.isatty(fd) for fd in range(3)],
    "runtime": runtime,
    "writing": {path: tried(path) for path in [
        "here", "/tmp/" + os.path.basename(home), os.environ["TMPDIR"] + "/file", sys.argv[1],
        home + "/.cache/st-emulator/file", home + "/.local/state/st-emulator/file", runtime + "/file",
        home + "/file", "/etc/st-emulator-test",
    ]},
}), file=sys.stderr)
os.system("sleep 1000 &")  # must not be waited for
sys.exit(7)
"""


@in_a_guest
def test_a_command_finds_what_it_would_find_here_and_a_vcan0(outside: Path) -> None:
    here, home, temporary, more = (
        outside / name for name in ("a folder, 'odd';", "home", "temporary", "more")
    )
    for folder in (here, home, temporary, more):
        folder.mkdir()
    arguments = ["", "two words", "new\nline", '$HOME `x` "q" \\', "'", "*", "-t", "--help", "ü€", "\udcff"]
    own = ("XDG_CACHE_HOME", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "NUMBA_CACHE_DIR", "MPLCONFIGDIR")
    environment = {key: value for key, value in os.environ.items() if key not in own}
    environment |= {"HOME": str(home), "TMPDIR": str(temporary), "ODD": "a\nb 'c' \"d\" $e"}
    command = [sys.executable, "-c", SURROUNDINGS, more / "file", *arguments]
    run = vcan("-w", more, *command, cwd=here, env=environment)
    assert (run.returncode, run.stdout) == (7, b""), run.stderr.decode()
    said = json.loads(run.stderr)
    assert said["frame"] == [0x123, 64]
    assert said["arguments"] == arguments
    assert said["odd"] == environment["ODD"]
    assert said["cwd"] == str(here)
    assert said["stdin"] == ""
    assert said["terminals"] == [False] * 3
    *written, runtime_file, in_home, in_system = said["writing"]
    assert len(written) == 6
    for path in written:
        assert said["writing"][path] == "written", path
        assert (here / path).read_text() == "written"  # and is here when the command has ended
    assert said["writing"][runtime_file] == "written"
    assert said["writing"][in_home] == said["writing"][in_system] == "Read-only file system"
    for path in (runtime_file, in_home, in_system):
        assert not Path(path).exists()
    Path(written[1]).unlink()
    # What had to be made so that the command can write there is there no longer where it did not.
    assert sorted(path.name for path in home.iterdir()) == [".cache", ".local"]
    assert [path.name for path in (home / ".cache").iterdir()] == ["st-emulator"]


NOISE = f"""
import random, sys
chance = random.Random(sys.argv[1])
sys.stdout.buffer.write(chance.randbytes({OUT_BYTES}))
sys.stderr.buffer.write(chance.randbytes({ERR_BYTES}))
"""


@in_a_guest
def test_all_output_comes_back_from_two_guests_at_once(tmp_path: Path) -> None:
    processes = []
    for seed in ("1", "2"):
        with (tmp_path / f"out-{seed}").open("wb") as out, (tmp_path / f"err-{seed}").open("wb") as err:
            processes.append(
                subprocess.Popen(
                    [TOOL, sys.executable, "-c", NOISE, seed],
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                )
            )
    for seed, process in zip(("1", "2"), processes, strict=True):
        assert process.wait(PATIENCE_S) == 0
        chance = random.Random(seed)
        assert (tmp_path / f"out-{seed}").read_bytes() == chance.randbytes(OUT_BYTES)
        assert (tmp_path / f"err-{seed}").read_bytes() == chance.randbytes(ERR_BYTES)


# -- how it ends


def descendants(pid: int) -> set[int]:
    """A process and all below it."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    found, more = set(), {pid}
    while more:
        found |= more
        more = {child for child, parent in parents.items() if parent in found} - found
    return found


def run(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def folder_of(processes: set[int]) -> Path:
    """The folder of a guest's files, from its kernel's command line."""
    for pid in processes:
        for word in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0"):
            if word.startswith(b"vcan_run="):
                return Path(os.fsdecode(word.partition(b"=")[2]))
    raise AssertionError("no guest's kernel")


def assert_nothing_is_left(processes: set[int], folder: Path) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while folder.exists() or any(run(pid) for pid in processes):
        assert time.monotonic() < deadline, (folder.exists(), [pid for pid in processes if run(pid)])
        time.sleep(0.02)


TAKES_ITS_TIME = """
import sys, time
try:
    print("started", flush=True)
    while True:  # a signal just before a long sleep would not end it: Python looks at it afterwards
        time.sleep(0.05)
except KeyboardInterrupt:
    open(sys.argv[1], "w").write("stopped" * 10_000)
    print("stopped")
    sys.exit(5)
"""


@in_a_guest
@pytest.mark.parametrize(
    ("number", "status", "said"),
    [(signal.SIGINT, 5, b"stopped\n"), (signal.SIGTERM, 128 + 15, b""), (signal.SIGKILL, -9, b"")],
    ids=["Ctrl-C", "SIGTERM", "SIGKILL"],
)
def test_a_signal_ends_the_command_and_leaves_nothing(
    tmp_path: Path, number: int, status: int, said: bytes
) -> None:
    command = [TOOL, sys.executable, "-c", TAKES_ITS_TIME, tmp_path / "file"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"started\n"
        processes = descendants(process.pid)
        folder = folder_of(processes)
        assert folder.is_dir()
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out, err) == (status, said, b"")
    assert_nothing_is_left(processes, folder)
    if number == signal.SIGINT:  # the command had time to write, and what it wrote is there
        assert (tmp_path / "file").read_text() == "stopped" * 10_000


@in_a_guest
def test_a_command_that_is_out_of_time() -> None:
    run = vcan("-t", "0.5", "bash", "-c", "echo begun; sleep 1000; echo ended")
    assert (run.returncode, run.stdout, run.stderr) == (124, b"begun\n", b"")


@in_a_guest
def test_nobody_reads_the_output_any_more() -> None:
    """As in `tools/vcan yes | head -1`."""
    with subprocess.Popen([TOOL, "yes"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"y\n"
        process.stdout.close()
        assert process.wait(PATIENCE_S) == 128 + signal.SIGPIPE


# -- without a guest


HERE = """
echo "$(ls /sys/class/net | grep -c vcan0) $VALUE"
cat
ip link add dev vcan_made type vcan && ip link show vcan_made | wc -l
exit 9
"""
WITHIN = """
ip link add dev vcan7 type vcan  # only in the first case seen by the command
VALUE=1 "$0" bash -c "$1" <<<read; echo "status $?"
ip link del vcan_made; ip link del vcan0
VALUE=2 "$0" bash -c "$1" <<<read; echo "status $?"
"$0" -t 0.2 sleep 1000; echo "status $?"
ls /sys/class/net | grep vcan
"""


@in_a_guest
def test_where_there_can_be_a_vcan0_no_guest_is_made() -> None:
    """Within a guest: with the vcan0 there is, and without it with one of the command's own."""
    run = vcan("bash", "-c", WITHIN, TOOL, HERE)
    assert run.stderr == b""
    assert run.stdout.decode().splitlines() == [
        *("1 1", "read", "2", "status 9"),
        *("1 2", "read", "2", "status 9"),
        *("status 124", "vcan7"),
    ]


# -- what it says


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        ([], 125, "a command is missing: tools/vcan [-t SECONDS] [-w DIR]... COMMAND [ARGUMENT]..."),
        (["-x", "true"], 125, "option -x not recognized; see tools/vcan --help"),
        (["-t", "0", "true"], 125, "-t 0: allowed is a number of seconds above 0"),
        (["-t", "soon", "true"], 125, "-t soon: allowed is a number of seconds above 0"),
        (["-w", "/no/such", "true"], 125, "-w /no/such: allowed is a folder that exists, and not /"),
        (["-w", "/", "true"], 125, "-w /: allowed is a folder that exists, and not /"),
        (["no-such-command"], 127, "no-such-command: command not found"),
        (["./no-such-command"], 127, "./no-such-command: command not found"),
        (["/etc/passwd"], 126, "/etc/passwd: not executable"),
    ],
)
def test_what_cannot_be_run(arguments: list[str], status: int, message: str, tmp_path: Path) -> None:
    run = vcan(*arguments, cwd=tmp_path)
    assert (run.returncode, run.stdout, run.stderr.decode()) == (status, b"", f"tools/vcan: {message}\n")


def test_help_teaches() -> None:
    run = vcan("--help")
    assert (run.returncode, run.stderr) == (0, b"")
    text = run.stdout.decode()
    for word in (
        "./tools/vcan .venv/bin/python -m pytest",
        "candump",
        "-t SECONDS",
        "-w DIR",
        "user-mode-linux",
    ):
        assert word in text
    assert max(map(len, text.splitlines())) <= 110


# -- its parts


@pytest.fixture
def packages(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """On a computer that has apt-get and insmod, and where a call of apt-get brings what it is asked for."""
    module = part("packages")
    there = {"apt-get", "insmod"}
    module.calls = []  # type: ignore[attr-defined]

    def install(line: list[str], **options: object) -> subprocess.CompletedProcess[bytes]:
        module.calls.append(line)  # type: ignore[attr-defined]
        there.update(name for name, package in module.PACKAGE_OF.items() if package in line)
        return subprocess.CompletedProcess(line, 0)

    monkeypatch.setattr(module, "program", lambda name: name if name in there else None)
    monkeypatch.setattr(module.subprocess, "run", install)
    return module


def test_root_gets_the_packages_that_are_missing(
    packages: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(packages.os, "geteuid", lambda: 0)
    assert packages.require_packages(WANTED) is None
    update, install = packages.calls
    assert "update" in update
    assert install[install.index("install") :] == [
        *("install", "-y", "--no-install-recommends", "user-mode-linux", "iproute2", "can-utils")
    ]
    assert "tools/vcan: installing user-mode-linux iproute2 can-utils" in capsys.readouterr().err
    assert packages.require_packages(WANTED) is None
    assert len(packages.calls) == 2


def test_others_are_told_what_is_missing(packages: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages.os, "geteuid", lambda: 1000)
    assert packages.require_packages(WANTED) == (
        "linux.uml, ip, candump missing; "
        "on Debian, as root: apt-get install user-mode-linux iproute2 can-utils"
    )
    assert packages.calls == []


def test_packages_that_cannot_be_had(packages: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages.os, "geteuid", lambda: 0)
    monkeypatch.setattr(packages.subprocess, "run", lambda line, **_: subprocess.CompletedProcess(line, 100))
    assert "apt-get could not install user-mode-linux" in packages.require_packages(WANTED)


@pytest.mark.parametrize("cut", range(1, 24))
def test_the_last_bytes_are_known_however_they_come(cut: int) -> None:
    """The token behind the output is not passed on, and what looks like its beginning is."""
    relay = part("relay")
    read_fd, write_fd = os.pipe()
    wake_read_fd, wake_write_fd = os.pipe()
    under_test = relay.Relay(write_fd, b"TOKENTOKEN", wake_write_fd)
    guest_fd = os.dup(under_test.guest_fd)
    under_test.start()
    data = b"output TOKENTOKE" + b"TOKENTOKEN"
    os.write(guest_fd, data[:cut])
    time.sleep(0.001)  # so that it comes in two pieces; in one it must be right too
    os.write(guest_fd, data[cut:])
    assert os.read(wake_read_fd, 1) == b"\0"  # though the guest has not closed it
    assert under_test.ended
    os.close(write_fd)
    assert os.read(read_fd, 100) == data[: -len(b"TOKENTOKEN")]
    for fd in (read_fd, wake_read_fd, wake_write_fd, guest_fd):
        os.close(fd)
