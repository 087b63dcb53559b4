"""``st-emulator run --lockstep`` and ``--control``: the socket's address, token and announcement."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..bench.emulator import Emulator
from ..drivers.control_server import ControlServer, loopback_address
from ..drivers.lockstep import Lockstep
from ..drivers.lockstep_requests import Requests
from ..drivers.lockstep_wire import VERSION
from ..drivers.token_file import token_of
from ..errors import ConfigurationError
from ..links import Link
from .state_folder import state_folder


@dataclass(frozen=True)
class ControlOptions:
    """The control socket of a run; ``steps``: its client owns the time. ``token_file``: None for one of this
    run alone.
    """

    address: tuple[str, int]
    steps: bool
    token_file: Path | None


@dataclass(frozen=True)
class Control:
    """The control socket, open, and where its token is."""

    server: ControlServer
    token_file: Path
    steps: bool

    def ready(self) -> dict[str, Any]:
        """Where it is to be reached, for a script."""
        host, port = self.server.address
        return {
            "host": host,
            "port": port,
            "token_file": str(self.token_file),
            "version": VERSION,
            "time": "lockstep" if self.steps else "paced",
        }

    def told(self) -> str:
        """The same for a person."""
        host, port = self.server.address
        shown = f"[{host}]" if ":" in host else host
        return f"{'lockstep' if self.steps else 'control'} on {shown}:{port}, token in {self.token_file}"


def control_options(
    *, lockstep: str | None, control: str | None, token_file: Path | None, attitude: str | None, speed: str
) -> ControlOptions | None:
    """What the options ask for; None without a control socket.

    Raises:
        ConfigurationError: options that do not go together, an address that is not loopback, a bad token
            file.
    """
    if attitude not in (None, "scenario", "outside"):
        raise ConfigurationError(f"--attitude {attitude}: allowed are scenario and outside")
    if attitude == "outside" and lockstep is None:
        raise ConfigurationError(
            "--attitude outside: only with --lockstep; a run that is paced by the computer would ask for a "
            "future that nobody outside knows"
        )
    if lockstep is not None and control is not None:
        raise ConfigurationError(f"--control {control}: --lockstep serves all of it; allowed is one of them")
    if lockstep is not None and speed != "1":
        raise ConfigurationError(
            f"--speed {speed} with --lockstep: the client owns the time; allowed is no --speed"
        )
    text = control if lockstep is None else lockstep
    if text is None:
        if token_file is not None:
            raise ConfigurationError(f"--lockstep-token-file {token_file}: only with --lockstep or --control")
        return None
    steps = lockstep is not None
    if not steps and speed == "max":
        raise ConfigurationError("--control with --speed max: allowed are speeds from 0.01 to 1000")
    return ControlOptions(loopback_address(text, "--lockstep" if steps else "--control"), steps, token_file)


def token_for(stack: contextlib.ExitStack, control: ControlOptions) -> tuple[Path, str]:
    """(token file, token); one that is of this run alone is deleted with the stack.

    Raises:
        ConfigurationError: the file is not fit for a token.
    """
    option = "--lockstep-token-file" if control.steps else "--control-token-file"
    if control.token_file is not None:
        return control.token_file.absolute(), token_of(control.token_file, option)
    path = state_folder() / f"control-{os.getpid()}.token"
    with contextlib.suppress(OSError):
        path.unlink()  # left by a process of this number that was killed
    token = token_of(path, option)
    stack.callback(path.unlink, missing_ok=True)
    return path, token


def open_control(
    stack: contextlib.ExitStack,
    control: ControlOptions,
    token: tuple[Path, str],
    emulator: Emulator,
    link: Link | None,
    until_ns: int | None,
    say: Callable[[str], None],
) -> Control:
    """The socket, open; closed with the stack."""
    requests = Requests(Lockstep(emulator, link), steps=control.steps, until_ns=until_ns)
    server = ControlServer(control.address, token[1], requests, say)
    stack.callback(server.close)
    return Control(server, token[0], control.steps)


def write_ready(path: str | None, ready: dict[str, Any]) -> None:
    """Say as JSON where the unit is to be reached: the file is whole as soon as it is there.

    Raises:
        ConfigurationError: it cannot be written.
    """
    if path is None:
        return
    text = json.dumps(ready) + "\n"
    if path == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    target = Path(path)
    part = target.with_name(f"{target.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(target)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise ConfigurationError(f"--json {path}: cannot be written: {error.strerror}") from error
