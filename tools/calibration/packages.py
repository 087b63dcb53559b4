"""The cross compiler's Debian packages, installed where that is allowed."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from tools.vcan_guest.packages import install_packages, program

__all__ = ["COMPILER_PACKAGES", "require_compiler"]

COMPILER_PACKAGES = ("gcc-arm-linux-gnueabi", "libc6-dev-armel-cross")


def require_compiler(program_name: str, tool: str, packages: Sequence[str] = COMPILER_PACKAGES) -> str | None:
    """See that the cross compiler is there, as root by installing it; what to tell the user if it is not."""
    if program(program_name) is not None:
        return None
    failure = install_packages(packages, tool)
    if failure:
        return f"{program_name} missing; {failure}"
    if program(program_name) is None:
        return f"{program_name} missing even with {' '.join(packages)} installed"
    print(f"{tool}: {program_name} is there now", file=sys.stderr)
    return None
