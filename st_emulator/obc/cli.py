"""`st-emulator obc`: the OBC simulator as shell, script runner and live view."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from ..errors import ConfigurationError
from ..links import LinkError
from ..protocol.can.cyclic import NODES
from ..report import write_json
from .client import Obc
from .desk import CommandError
from .errors import RecordingError
from .session import Line, Session, parse_lines
from .shell import run_shell
from .watching import watch

INTERRUPTED_STATUS = 130
Connect = Callable[..., Obc]

obc_app = typer.Typer(invoke_without_command=True, subcommand_metavar="", pretty_exceptions_enable=False)


@obc_app.callback()
def obc(
    context: typer.Context,
    link: Annotated[
        str,
        typer.Option(
            "--link",
            metavar="LINK",
            help="`pty:PATH`, `serial:DEV[@BAUD]`, a bare path, or a CAN bus: `can:socketcan/vcan0`, "
            "`can:slcan/DEV`, each with `@BITRATE` and `,fd` if wanted; `pty` finds the emulator that runs.",
        ),
    ] = "pty",
    apid: Annotated[
        int | None,
        typer.Option(
            "--apid", min=0, max=2046, help="The unit's APID. Default: that of the first telemetry."
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            "--unit",
            "-u",
            metavar="UNIT",
            help="Take APID, rates and CAN identifiers from a unit or unit file.",
        ),
    ] = None,
    node: Annotated[
        int | None,
        typer.Option(
            "--node",
            min=NODES[0],
            max=NODES[-1],
            help="The unit's node number on a CAN bus. Default: the unit file's, else that of the only "
            "heartbeat.",
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            "--record", metavar="DIR", help="Record telemetry and telecommands (JSON lines and CSV)."
        ),
    ] = None,
    script: Annotated[
        Path | None,
        typer.Option(
            "--script", metavar="FILE", help="Run commands from a file, one a line, # for comments."
        ),
    ] = None,
    command: Annotated[
        list[str] | None,
        typer.Option("--command", "-c", metavar="TEXT", help="Run a command; may be given several times."),
    ] = None,
    watching: Annotated[bool, typer.Option("--watch", help="Live view until Ctrl-C.")] = False,
    json_path: Annotated[
        str | None,
        typer.Option(
            "--json", metavar="FILE", help="Write figures and checks as JSON (- for standard output)."
        ),
    ] = None,
) -> None:
    """Talk to a star tracker as its on-board computer: a shell, or a script whose exit status says whether
    it held.

    Exit status: 0 all held, 1 a command failed or an expectation did not hold, 2 wrong arguments.
    """
    connect: Connect = context.obj if callable(context.obj) else Obc.connect
    output = Console(stderr=json_path == "-", soft_wrap=True, highlight=False, markup=False)
    errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    try:
        options = {} if unit is None else _unit_options(unit)
        options |= {name: value for name, value in (("apid", apid), ("node", node)) if value is not None}
        lines = _lines(script, command, watching)
        with connect(link, record=record, **options) as obc:
            session = Session(obc, output.print, lambda obc, duration_s: watch(obc, duration_s, output))
            held = run_shell(session, errors.print) if lines is None else session.run_all(lines, errors.print)
            write_json(json_path, session.figures(), session.checks)
    except (ConfigurationError, LinkError, RecordingError, CommandError) as error:
        errors.print(f"st-emulator obc: {error}")
        raise typer.Exit(2) from None
    except KeyboardInterrupt:
        errors.print("interrupted")
        raise typer.Exit(INTERRUPTED_STATUS) from None
    raise typer.Exit(0 if held else 1)


def _lines(script: Path | None, command: list[str] | None, watching: bool) -> list[Line] | None:
    """What is to be run; None: what is typed."""
    if sum((script is not None, bool(command), watching)) > 1:
        raise ConfigurationError("--script, --command and --watch exclude each other")
    if script is not None:
        return parse_lines(_script_lines(script), f"{script}, line")
    if command:
        return parse_lines(command, "command")
    return parse_lines(["watch"], "--watch, line") if watching else None


def _unit_options(unit: str) -> dict[str, Any]:
    from ..units.profile import load_unit

    profile = load_unit(unit)
    wire = profile.wire
    return {"unit": unit, "apid": wire.apid, "baud": wire.baud, "source_id": wire.source_id}


def _script_lines(script: Path) -> list[str]:
    try:
        return script.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no UTF-8 text"
        raise ConfigurationError(f"--script {script}: cannot be read: {reason}") from error
