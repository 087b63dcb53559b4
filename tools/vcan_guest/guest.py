"""The guest: a Linux kernel with CAN as a process of this computer, for one command.

Pipes join the two: the command's output, its errors, reports from the guest (started, ended STATUS, failed
WHY) and orders to it (the name of a signal). A keeper process beside this one ends the guest and removes what
was made, however this process ends.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from keeper import Keeper
from packages import program
from relay import Relay

BOOT_S = 120.0  # it takes two; more on a computer that is busy with other things
GRACE_S = 10.0  # from a signal passed on to the end of the guest
OUTPUT_S = 5.0  # for what a guest that was ended had written
MOST_MEMORY_MB, LEAST_MEMORY_MB = 3072, 256
LOG_LINES = 25
USER_FOLDERS = (
    ("XDG_CACHE_HOME", ".cache", "st-emulator"),
    ("XDG_STATE_HOME", ".local/state", "st-emulator"),
    ("XDG_CACHE_HOME", ".cache", "matplotlib"),
    ("XDG_CONFIG_HOME", ".config", "matplotlib"),
)
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
TIMED_OUT, FAILED = 124, 125


class GuestError(Exception):
    """The guest could not do its part; says why."""


def run(command: Sequence[str], limit_s: float | None, writable: Sequence[str]) -> int:
    """Run a command in a guest; the exit status."""
    for fd in (0, 1, 2):  # a pipe of ours must not take the place of one that is closed
        try:
            os.fstat(fd)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    relays: list[Relay] = []
    with Keeper() as keeper:
        wake_fd, waker_fd = _signals()
        # Always in /tmp: sockets are made in it, so its path must be short, and the kernel takes no blanks.
        folder = Path("/tmp") / f"st-emulator-vcan-{secrets.token_hex(8)}"
        keeper.remove(folder)
        try:
            _describe(folder, keeper, command, writable)
            guest = _Guest(folder, keeper, relays, wake_fd, waker_fd)
            status = guest.attend(limit_s)
        except GuestError as error:
            print(f"tools/vcan: the guest failed: {error}", file=sys.stderr)
            status = FAILED
    for relay in relays:
        relay.join(OUTPUT_S)
    return status


def _signals() -> tuple[int, int]:
    """The two ends of a pipe in which signals become bytes, their numbers."""
    read_fd, write_fd = os.pipe()
    os.set_blocking(write_fd, False)

    def note(number: int, frame: FrameType | None) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(write_fd, bytes([number]))

    for number in STOPPING:
        if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
            signal.signal(number, note)
    return read_fd, write_fd


def _describe(folder: Path, keeper: Keeper, command: Sequence[str], writable: Sequence[str]) -> None:
    """Write down for the guest what to run, with what environment and where it may write."""
    try:
        here = os.getcwd()
    except OSError as error:
        raise GuestError("the current directory has gone") from error
    environment = dict(os.environ, XDG_RUNTIME_DIR="/run/user")
    for key in ("LINES", "COLUMNS"):  # there is no terminal
        environment.pop(key, None)
    try:
        folder.mkdir(mode=0o700)
        shutil.copy(Path(__file__).with_name("init"), folder / "init")
        _write_items(folder / "argv", [here, *command])
        _write_items(folder / "environment", [f"{key}={value}" for key, value in environment.items()])
        _write_items(folder / "writable", _writable_folders(keeper, here, writable))
    except OSError as error:
        raise GuestError(f"{folder} cannot be written: {error.strerror}") from error


def _write_items(path: Path, items: Sequence[str]) -> None:
    path.write_bytes(b"".join(os.fsencode(item) + b"\0" for item in items))


def _writable_folders(keeper: Keeper, here: str, more: Sequence[str]) -> list[str]:
    """Real paths, none within another. The user's folders are made when missing, as the guest cannot."""
    wanted = [here, "/tmp", *more]
    wanted += [os.environ.get(variable, "") for variable in ("TMPDIR", "NUMBA_CACHE_DIR", "MPLCONFIGDIR")]
    for variable, default, name in USER_FOLDERS:
        root = os.environ.get(variable, "")
        own = os.path.join(root if os.path.isabs(root) else os.path.expanduser(f"~/{default}"), name)
        missing = own
        while not os.path.exists(missing):
            keeper.remove_if_empty(missing)
            missing = os.path.dirname(missing)
        with contextlib.suppress(OSError):  # a home that is not to be written
            os.makedirs(own, exist_ok=True)
        wanted.append(own)
    real = {os.path.realpath(folder) for folder in wanted if folder and os.path.isdir(folder)} - {"/"}
    return [folder for folder in sorted(real) if not any(folder.startswith(f"{other}/") for other in real)]


class _Guest:
    """A guest that boots, its command, and what is asked of it meanwhile."""

    def __init__(
        self, folder: Path, keeper: Keeper, relays: list[Relay], wake_fd: int, waker_fd: int
    ) -> None:
        token = secrets.token_hex(16)
        self._log = folder / "log"
        self._wake_fd = wake_fd
        self._relays = relays
        relays += [Relay(fd, token.encode(), waker_fd) for fd in (1, 2)]
        self._report_fd, guest_report_fd = os.pipe()
        guest_order_fd, self._order_fd = os.pipe()
        os.set_blocking(self._order_fd, False)
        out_fd, err_fd = (relay.guest_fd for relay in relays)
        memory_folder, memory_mb = _memory()
        line = [
            *_ended_with_us(),
            *(program("linux.uml") or "linux.uml", "rootfstype=hostfs", "rootflags=/", "ro"),
            *(f"mem={memory_mb}M", "random.trust_cpu=on", f"init={folder}/init"),
            *("con=null", "ssl=null", "con0=null,fd:1", f"con1=null,fd:{out_fd}", f"con2=null,fd:{err_fd}"),
            *(f"con3=fd:{guest_order_fd},fd:{guest_report_fd}", f"uml_dir={folder}/", "umid=guest"),
            *(f"vcan_run={folder}", f"vcan_token={token}"),
        ]
        with self._log.open("wb") as log:
            process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=(out_fd, err_fd, guest_order_fd, guest_report_fd),
                start_new_session=True,  # Ctrl-C at the terminal reaches the command through us
                env=os.environ | {"TMPDIR": memory_folder},
            )
        keeper.end(process.pid)
        os.close(guest_order_fd)
        os.close(guest_report_fd)
        for relay in relays:
            relay.start()
        self._reports = b""

    def attend(self, limit_s: float | None) -> int:
        """Until the command has ended and its output is passed on, or until it must be ended; the status."""
        started = False
        ended: int | None = None
        instead: int | None = None  # the status if the command has to be ended
        deadline: float | None = time.monotonic() + BOOT_S
        while ended is None or not all(relay.ended for relay in self._relays):
            left_s = None if deadline is None else max(0.0, deadline - time.monotonic())
            watched = [self._wake_fd] if ended is not None else [self._wake_fd, self._report_fd]
            ready, _, _ = select.select(watched, [], [], left_s)
            order = None
            if self._report_fd in ready:
                report, _, value = self._report().partition(" ")
                if report == "failed":
                    raise GuestError(value)
                if report == "started":
                    started = True
                    deadline = None if limit_s is None else time.monotonic() + limit_s
                elif report == "ended":
                    ended, deadline = int(value), None
            elif self._wake_fd in ready:
                number = os.read(self._wake_fd, 1)[0]
                if number == 0 and instead is None and any(relay.broken for relay in self._relays):
                    number = signal.SIGPIPE
                if number:
                    if not started or ended is not None or instead is not None:
                        return 128 + number
                    order, instead = number, 128 + number
            elif not started:
                raise GuestError(f"it did not start within {BOOT_S:g} s{self._log_text()}")
            elif instead is not None:
                return instead
            else:
                order, instead = signal.SIGTERM, TIMED_OUT
            if order is not None:
                self._pass_on(order)
                deadline = time.monotonic() + GRACE_S
        return TIMED_OUT if instead == TIMED_OUT else ended

    def _report(self) -> str:
        """The guest's next report, "" for part of one."""
        data = os.read(self._report_fd, 4096)
        if not data:
            raise GuestError(f"its kernel has ended{self._log_text()}")
        report, line_end, rest = (self._reports + data).partition(b"\n")
        self._reports = rest if line_end else report
        return os.fsdecode(report) if line_end else ""

    def _pass_on(self, number: int) -> None:
        with contextlib.suppress(OSError):
            os.write(self._order_fd, f"{signal.Signals(number).name}\n".encode())

    def _log_text(self) -> str:
        lines = self._log.read_text(errors="replace").splitlines()[-LOG_LINES:]
        return "".join(f"\n  {line}" for line in ["its log ends with:", *lines])


def _ended_with_us() -> list[str]:
    """What a command is prefixed with so that the kernel ends it when this process is gone."""
    prefix = ["setpriv", "--pdeathsig", "KILL", "--"]
    # All of a guest's processes: only root may have them in a namespace of their own.
    apart = ["unshare", "--pid", "--fork", "--kill-child", "--"]
    tried = subprocess.run([*apart, "true"], stdin=subprocess.DEVNULL, capture_output=True, check=False)
    return prefix + apart if tried.returncode == 0 else prefix


def _memory() -> tuple[str, int]:
    """The folder for the file that is the guest's memory, of which only what is used takes room, and its size
    in megabytes.
    """
    total_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20
    wanted_mb = min(MOST_MEMORY_MB, total_mb // 2)
    best = ("/tmp", 0)
    for folder in ("/dev/shm", "/tmp", "/var/tmp"):
        try:
            status = os.statvfs(folder)
        except OSError:
            continue
        free_mb = status.f_bavail * status.f_frsize >> 20
        if status.f_flag & os.ST_NOEXEC or not os.access(folder, os.W_OK):
            continue  # it holds programs too
        if free_mb > wanted_mb:
            return folder, wanted_mb
        if free_mb > best[1]:
            best = (folder, free_mb)
    if best[1] < LEAST_MEMORY_MB:
        raise GuestError(
            f"its memory needs {LEAST_MEMORY_MB} MB in /dev/shm, /tmp or /var/tmp, mounted without noexec"
        )
    return best
