"""The stable link path of a pseudo-terminal, and what becomes of bytes that nobody reads."""

import fcntl
import os
import select
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from st_emulator.links import LinkError, open_link
from st_emulator.links.pty import INPUT_QUEUE_BYTES, STALE_AFTER_NS, PtyLink, live_paths

PATIENCE_S = 20.0  # only bounds a hang


class SteppedTime:
    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


@pytest.fixture
def time() -> SteppedTime:
    return SteppedTime()


@pytest.fixture
def link(tmp_path: Path, time: SteppedTime) -> Iterator[PtyLink]:
    with PtyLink(tmp_path / "unit", monotonic_ns=time) as opened:
        yield opened


def read_now(fd: int) -> bytes:
    return os.read(fd, 65536) if select.select([fd], [], [], PATIENCE_S)[0] else b""


def has_input(fd: int) -> bool:
    return bool(select.select([fd], [], [], 0.05)[0])


def test_the_path_leads_to_the_terminal_and_goes_at_close(tmp_path: Path) -> None:
    path = tmp_path / "unit"
    link = PtyLink(path)
    assert path.is_symlink()
    assert os.path.samefile(path, link.device)
    link.close()
    assert list(tmp_path.iterdir()) == []


def test_a_second_emulator_is_refused_while_the_first_runs(link: PtyLink) -> None:
    with pytest.raises(LinkError, match=r"^pty:\S+/unit: a running emulator has this link"):
        PtyLink(link.path)
    assert os.path.samefile(link.path, link.device)  # and has done no harm


def test_a_link_left_by_a_killed_emulator_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "unit"
    script = (
        "import sys, time; from st_emulator.links.pty import PtyLink; link = PtyLink(sys.argv[1]);"
        "print('open', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == "open\n"
        with pytest.raises(LinkError, match="a running emulator has this link"):
            PtyLink(path)
        process.send_signal(signal.SIGKILL)
        process.wait(PATIENCE_S)
    assert path.is_symlink()
    with PtyLink(path) as link:
        assert os.path.samefile(path, link.device)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["file", "folder", "link elsewhere"])
def test_what_is_not_ours_is_left_alone(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "precious"
    if kind == "file":
        path.write_text("data")
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(tmp_path / "somewhere")
    before = os.lstat(path)
    with pytest.raises(LinkError, match="the path exists and is no link to a pseudo-terminal"):
        PtyLink(path)
    assert os.path.samestat(before, os.lstat(path))
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"the folder \S+/missing does not exist"):
        PtyLink(tmp_path / "missing" / "unit")


def test_a_reader_gets_everything_within_the_second(link: PtyLink, time: SteppedTime) -> None:
    link.write(b"first")
    time.now_ns += STALE_AFTER_NS - 1
    link.write(b"second")
    with open(link.path, "rb", buffering=0) as reader:
        received = b""
        while len(received) < len(b"firstsecond"):
            received += read_now(reader.fileno())
    assert received == b"firstsecond"


def test_a_late_reader_gets_no_old_bytes(link: PtyLink, time: SteppedTime) -> None:
    with open(link.path, "rb", buffering=0) as reader:
        link.write(b"old")
        assert select.select([reader.fileno()], [], [], PATIENCE_S)[0]  # it has crossed the kernel
        time.now_ns += STALE_AFTER_NS
        link.write(b"new")
        assert read_now(reader.fileno()) == b"new"
    assert link.dropped_bytes == 3


def test_reading_alone_also_flushes_what_is_stale(link: PtyLink, time: SteppedTime) -> None:
    with open(link.path, "rb", buffering=0) as reader:
        link.write(b"old")
        assert select.select([reader.fileno()], [], [], PATIENCE_S)[0]
        time.now_ns += STALE_AFTER_NS
        assert link.read() == b""
        assert not has_input(reader.fileno())


def await_unread(descriptor: int, count: int) -> None:
    """Until the kernel has moved so many bytes into the reader's queue, which it does in its own time."""
    for _ in range(int(PATIENCE_S / 0.005)):
        (waiting,) = struct.unpack("i", fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)))
        if waiting >= count:
            return
        select.select([], [], [], 0.005)
    raise AssertionError(f"the reader's queue has {waiting} bytes after {PATIENCE_S} s, not {count}")


def test_a_backlog_beyond_the_input_queue_is_flushed_whole(link: PtyLink, time: SteppedTime) -> None:
    taken = 0
    while not link.dropped_bytes:
        taken += link.write(bytes(500))
    dropped = link.dropped_bytes
    time.now_ns += STALE_AFTER_NS
    with open(link.path, "rb", buffering=0) as reader:
        await_unread(reader.fileno(), INPUT_QUEUE_BYTES)
        assert link.write(b"new") == 3
        assert read_now(reader.fileno()) == b"new"
    assert link.dropped_bytes == dropped + taken


def test_a_reader_who_keeps_up_never_loses_a_byte(link: PtyLink, time: SteppedTime) -> None:
    with open(link.path, "rb", buffering=0) as reader:
        for number in range(20):
            message = number.to_bytes(4, "big") * 20
            assert link.write(message) == len(message)
            received = b""
            while len(received) < len(message):
                received += read_now(reader.fileno())
            assert received == message
            time.now_ns += STALE_AFTER_NS // 2
    assert link.dropped_bytes == 0


def test_an_obc_may_come_go_and_come_again(link: PtyLink) -> None:
    for _ in range(3):
        with open_link(f"pty:{link.path}", role="obc") as obc:
            obc.write(b"ping")
            fd = link.fileno()
            assert fd is not None
            assert select.select([fd], [], [], PATIENCE_S)[0]
            assert link.read() == b"ping"


def test_default_path_is_the_units_name_in_the_runtime_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with open_link("pty", role="unit", default_name="roja1") as first:
        path = tmp_path / "st-emulator" / "roja1"
        assert first.name == f"pty:{path}"
        assert live_paths() == [path]
        with open_link("pty", role="obc", default_name="unit") as obc:  # the only one that runs
            assert obc.name.startswith(f"serial:{path}@")
        with open_link("pty", role="unit", default_name="zy3"):
            with pytest.raises(LinkError, match=r"several emulators run; name one: pty:\S+roja1, pty:\S+zy3"):
                open_link("pty", role="obc", default_name="unit")
            with open_link("pty", role="obc", default_name="zy3") as obc:
                assert "zy3" in obc.name
    with pytest.raises(LinkError, match="no emulator runs"):
        open_link("pty", role="obc")


def test_a_link_left_in_the_runtime_folder_is_not_live(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with open_link("pty", role="unit", default_name="alive") as alive:
        (tmp_path / "st-emulator" / "dead").symlink_to(os.path.realpath(alive.name.removeprefix("pty:")))
        assert [path.name for path in live_paths()] == ["alive"]


def test_the_lock_is_held_on_the_file_that_is_there(tmp_path: Path) -> None:
    """A lock taken on a file that its holder has just removed protects nothing."""
    path = tmp_path / "unit"
    with PtyLink(path), open(f"{path}.lock", "rb") as lock, pytest.raises(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
