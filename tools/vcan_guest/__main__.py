"""A command with a vcan0: on this computer where its kernel has one, else in a guest.

Python's standard library alone: this runs before anything is installed.
"""

from __future__ import annotations

import getopt
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

import guest
from packages import require_packages

HELP = """usage: tools/vcan [-t SECONDS] [-w DIR]... COMMAND [ARGUMENT]...

Runs COMMAND where there is a CAN bus called vcan0, for example

    ./tools/vcan ./tools/demo --link can:socketcan/vcan0 --seconds 20 --json demo.json
    ./tools/vcan .venv/bin/python -m pytest -m vcan
    ./tools/vcan bash -c 'candump -L vcan0 > bus.log & sleep 0.5; cansend vcan0 123#DEADBEEF; sleep 0.5'

Where this computer has a vcan0 that is up, COMMAND simply runs with it. For root on a kernel that can have
one, COMMAND gets a vcan0 of its own in a network namespace. Everywhere else it runs in a guest: a Linux
kernel with CAN as an ordinary process (User-mode Linux), which sees this computer's files. It needs no
privileges and takes two seconds to boot. To have a vcan0 of the computer's own, for several terminals:

    sudo modprobe vcan; sudo ip link add dev vcan0 type vcan; sudo ip link set vcan0 mtu 72 up

  -t SECONDS  end COMMAND after this time (exit status 124)
  -w DIR      COMMAND may write in DIR too

In the guest COMMAND writes in the current directory, in /tmp and $TMPDIR, in the folders that st-emulator
keeps for its user (cache and state), and in each DIR; all else is read-only. What it writes is on the disk
when it has ended. It has one processor, no network but a loopback, a runtime folder of its own
($XDG_RUNTIME_DIR) and nothing on standard input. File locks do not reach out of the guest.

Standard output, standard error and the exit status are COMMAND's. Ctrl-C and SIGTERM are passed on to it; a
second one ends it at once. Exit status 124: out of time; 125: there is no vcan0 to be had, and why;
126, 127: COMMAND cannot be run.

Packages (installed with apt-get when root runs this): user-mode-linux iproute2 kmod can-utils
"""

ROOT = Path(__file__).resolve().parents[2]
PREPARE = ["bash", "-c", '. "$0/tools/environment.sh" && prepare_environment "$0"', str(ROOT)]
INTERFACE = Path("/sys/class/net/vcan0")
FAILED = 125
INTERFACE_UP = 0x1  # IFF_UP of linux/if.h
OWN_VCAN0 = """
(
    PATH=$PATH:/usr/sbin:/sbin
    mount -t sysfs sysfs /sys
    ip link set lo up && ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 up
) && exec "$@"
"""


def main(arguments: list[str]) -> int:
    """The exit status; does not return where the command runs on this computer."""
    try:
        options, command = getopt.getopt(arguments, "ht:w:", ["help"])
    except getopt.GetoptError as error:
        return refuse(f"{error}; see tools/vcan --help")
    limit_s: float | None = None
    writable = []
    for option, value in options:
        if option in ("-h", "--help"):
            print(HELP, end="")
            return 0
        if option == "-t":
            limit_s = seconds(value)
            if limit_s is None:
                return refuse(f"-t {value}: allowed is a number of seconds above 0")
        else:
            if not os.path.isdir(value) or os.path.realpath(value) == "/":
                return refuse(f"-w {value}: allowed is a folder that exists, and not /")
            writable.append(value)
    if not command:
        return refuse("a command is missing: tools/vcan [-t SECONDS] [-w DIR]... COMMAND [ARGUMENT]...")
    own_can = kernel_has_can()
    if is_ours(command[0]) and not (own_can and is_up()) and not prepare():
        return FAILED
    if shutil.which(command[0]) is None:
        if "/" in command[0] and os.path.exists(command[0]):
            return refuse(f"{command[0]}: not executable", 126)
        return refuse(f"{command[0]}: command not found", 127)
    if own_can and is_up():
        run_here([], command, limit_s)
    if own_can and os.geteuid() == 0 and require_packages(["ip"]) is None:
        with_own = ["unshare", "--net", "--mount", "--", "sh", "-c", OWN_VCAN0, "vcan"]
        if subprocess.run([*with_own, "true"], capture_output=True, check=False).returncode == 0:
            run_here(with_own, command, limit_s)
    missing = require_packages(["linux.uml", "ip", "insmod", "candump"])
    if missing:
        return refuse(missing)
    return guest.run(command, limit_s, writable)


def run_here(prefix: list[str], command: list[str], limit_s: float | None) -> NoReturn:
    """Become the command."""
    within = [] if limit_s is None else ["timeout", "-k", "5", f"{limit_s:f}"]
    line = [*prefix, *within, *command]
    os.execvp(line[0], line)


def seconds(text: str) -> float | None:
    """A time limit; None: it is none."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0 < value < 1e9 else None


def is_ours(command: str) -> bool:
    """Whether the command needs this project installed: it lies in its folder, say tools/demo."""
    return "/" in command and ROOT in Path(os.path.abspath(command)).parents


def prepare() -> bool:
    """Install the project now: where the command will run there is no network."""
    return subprocess.run(PREPARE, stdout=sys.stderr, check=False).returncode == 0


def kernel_has_can() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def is_up() -> bool:
    """Whether this computer has a vcan0 that can be used."""
    try:
        return bool(int((INTERFACE / "flags").read_text(), 0) & INTERFACE_UP)
    except (OSError, ValueError):
        return False


def refuse(text: str, status: int = FAILED) -> int:
    print(f"tools/vcan: {text}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
