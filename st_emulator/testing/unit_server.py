"""A process that has all that a unit needs loaded, and forks a unit for each test that wants one.

To start Python, load numba and warm up kernels takes seconds, each time; a fork takes milliseconds. One
server serves one test process (each worker of xdist has its own) and ends with it, as its units do: it holds
one end of a socket pair whose other end closes when that process is gone. Run as ``python -m
st_emulator.testing.unit_server FD``.
"""

from __future__ import annotations

import array
import contextlib
import json
import os
import signal
import socket
import sys
import traceback
from pathlib import Path
from typing import Any

MESSAGE_BYTES = 65_536


def serve(descriptor: int) -> None:
    """Fork units until the other end closes: each message holds options of a run, and comes with the unit's
    supervisor socket and where its standard error goes.
    """
    from ..commands.running import RunOptions, run_unit
    from ..errors import ConfigurationError
    from ..links import LinkError

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the tests
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the units here
    with socket.socket(fileno=descriptor) as server:
        while True:
            message, descriptors, _, _ = socket.recv_fds(server, MESSAGE_BYTES, 2)
            if not message:
                return
            options: dict[str, Any] = json.loads(message)
            _load(options)
            if os.fork() == 0:
                status = 1
                try:
                    supervisor, errors = descriptors
                    server.close()
                    os.dup2(errors, 2)
                    os.close(errors)
                    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                    os.chdir(options.pop("folder"))
                    journal = options.pop("journal")
                    made = RunOptions(
                        **options, supervisor=supervisor, journal=None if journal is None else Path(journal)
                    )
                    run_unit(made)
                    status = 0
                except (ConfigurationError, LinkError) as error:
                    print(f"error: {error}", file=sys.stderr)
                    status = 2
                except BaseException:
                    traceback.print_exc()
                finally:
                    sys.stderr.flush()
                    os._exit(status)
            for one in descriptors:
                os.close(one)


def _load(options: dict[str, Any]) -> None:
    """Load what a unit needs here, so that no fork has to: its tables, its kernels. What is wrong with it the
    unit itself says.
    """
    from ..commands.warm_up import compile_apart, warm_up
    from ..errors import ConfigurationError
    from ..units.profile import load_unit

    with contextlib.suppress(ConfigurationError):
        profile = load_unit(options["unit"])
        compile_apart(profile)
        warm_up(profile)


def send(server: socket.socket, options: dict[str, Any], descriptors: list[int]) -> None:
    """Ask the server for a unit."""
    rights = array.array("i", descriptors)
    server.sendmsg([json.dumps(options).encode()], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, rights)])


if __name__ == "__main__":
    serve(int(sys.argv[1]))
