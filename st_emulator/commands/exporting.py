"""``st-emulator export``: documents and schemas generated from the code."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ..errors import ConfigurationError

export_app = typer.Typer(no_args_is_help=True, help="Write documents and schemas generated from the code.")


def _write_document(text: str, out: Path, check: bool) -> None:
    """Write a generated document, or with ``check`` say whether the written one is up to date."""
    if check:
        try:
            stale = not out.exists() or out.read_bytes() != text.encode()
        except OSError as error:
            raise ConfigurationError(f"{out}: cannot be read: {error.strerror}") from error
        if stale:
            raise ConfigurationError(
                f"{out}: out of date; write it anew with the same command without --check"
            )
        print(f"{out}: up to date")
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{out}: cannot be written: {error.strerror}") from error
    print(out)


Stale = Annotated[
    bool, typer.Option("--check", help="Write nothing; exit with status 2 when the document is out of date.")
]


@export_app.command("icd")
def export_icd(
    out: Annotated[Path, typer.Option("--out", metavar="FILE")] = Path("docs/interface_control_document.md"),
    check: Stale = False,
) -> None:
    """The interface control document, from the message registry."""
    from .documents import interface_control_document_text

    _write_document(interface_control_document_text(), out, check)


@export_app.command("scenario-schema")
def export_scenario_schema(
    out: Annotated[Path, typer.Option("--out", metavar="FILE")] = Path("docs/scenario.schema.json"),
    check: Stale = False,
) -> None:
    """The JSON schema of scenario files."""
    from ..bench.scenario import Scenario
    from .documents import schema_text

    _write_document(schema_text(Scenario), out, check)


@export_app.command("unit-schema")
def export_unit_schema(
    out: Annotated[Path, typer.Option("--out", metavar="FILE")] = Path("docs/unit.schema.json"),
    check: Stale = False,
) -> None:
    """The JSON schema of unit files."""
    from ..units.profile import UnitProfile
    from .documents import schema_text

    _write_document(schema_text(UnitProfile), out, check)


@export_app.command("dbc")
def export_dbc(
    units: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="UNIT[:NODE]",
            help="Units of the bus, each with the node number of its file or with another. Default: the "
            "shipped units.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "--out",
            metavar="FILE",
            help="Default: docs/units.dbc for the shipped units, else standard output.",
        ),
    ] = None,
    fd: Annotated[
        bool, typer.Option("--fd", help="For a link with `,fd`: transport frames of up to 64 bytes.")
    ] = False,
    check: Stale = False,
) -> None:
    """The frames of units on a CAN bus as a DBC file, for any CAN tool."""
    from .documents import can_database_text

    text = can_database_text(units or (), fd=fd)
    if out is None and not units and not fd:
        out = Path("docs/units.dbc")
    if out is not None:
        _write_document(text, out, check)
    elif check:
        raise ConfigurationError("--check: needs --output FILE, as standard output cannot be out of date")
    else:
        sys.stdout.write(text)


@export_app.command("fmu")
def export_fmu(
    unit: Annotated[str, typer.Argument(metavar="UNIT", help="A shipped unit or the path of a unit file.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Default: UNIT.fmu in the current folder.")
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scenario",
            metavar="FILE",
            help="Start, sky, parameters and faults; its trajectory is not heeded: the attitude is an input.",
        ),
    ] = None,
) -> None:
    """A unit as a co-simulation FMU (FMI 2.0): true attitude, rate, Sun and power in, attitude reports out.

    Needs `pip install 'st-emulator[fmu]'`. What runs the FMU needs a Python with a shared library that has
    this package installed.
    """
    from .fmu import write_fmu

    print(write_fmu(unit, out, scenario))


@export_app.command("dialects")
def export_dialects(
    out: Annotated[Path, typer.Option("--out", metavar="DIR")] = Path("docs/dialects"),
    check: Stale = False,
) -> None:
    """The interface document of each dialect beside PUS, from its message definitions."""
    from ..dialects.registry import SHIPPED

    for definition in SHIPPED:
        if definition.document is not None:
            _write_document(definition.document(), out / f"{definition.name}.md", check)
