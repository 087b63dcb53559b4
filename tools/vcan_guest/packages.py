"""Debian packages that are needed, installed where that is allowed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence

PACKAGE_OF = {
    "linux.uml": "user-mode-linux",
    "ip": "iproute2",
    "insmod": "kmod",
    "candump": "can-utils",
}
SEARCH_PATH = os.pathsep.join((os.environ.get("PATH", ""), "/usr/local/sbin:/usr/sbin:/sbin:/usr/bin:/bin"))
LOCK_TIMEOUT_S = 600  # two tools at once on a new machine: one waits for the other's apt-get


def program(name: str) -> str | None:
    """Where a program is; the system's own folders are looked through too."""
    return shutil.which(name, path=SEARCH_PATH)


def require_packages(programs: Sequence[str]) -> str | None:
    """See that the programs are there, as root by installing them; what to tell the user if they are not."""
    missing = [name for name in programs if program(name) is None]
    if not missing:
        return None
    packages = [PACKAGE_OF[name] for name in missing]
    failure = install_packages(packages, "tools/vcan")
    if failure:
        return f"{', '.join(missing)} missing; {failure}" if failure.startswith("on Debian") else failure
    still = [name for name in programs if program(name) is None]
    return f"{', '.join(still)} missing even with {' '.join(packages)} installed" if still else None


def install_packages(packages: Sequence[str], tool: str) -> str | None:
    """Install Debian packages, as root, and say so in the name of ``tool``; what to tell the user if not."""
    wanted = " ".join(packages)
    if os.geteuid() != 0 or program("apt-get") is None:
        return f"on Debian, as root: apt-get install {wanted}"
    print(f"{tool}: installing {wanted} with apt-get", file=sys.stderr)
    options = ["-qq", "-o", f"DPkg::Lock::Timeout={LOCK_TIMEOUT_S}"]
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    for arguments in (["update"], ["install", "-y", "--no-install-recommends", *packages]):
        line = ["apt-get", *options, *arguments]
        done = subprocess.run(line, stdin=subprocess.DEVNULL, stdout=sys.stderr, env=environment, check=False)
        if done.returncode:
            return f"apt-get could not install {wanted} (see its message above)"
    return None
