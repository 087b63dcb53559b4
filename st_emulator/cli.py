"""The command line: ``st-emulator``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from .budget.cli import budget
from .commands.exporting import export_app
from .errors import ConfigurationError

app = typer.Typer(
    name="st-emulator",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Hardware-in-the-loop star tracker firmware emulator: a star tracker on a serial line or a CAN bus, "
    "from the sky to the bytes.",
)
app.add_typer(export_app, name="export")

Json = Annotated[
    str | None,
    typer.Option(
        "--json", metavar="FILE", help="Write the figures and checks as JSON (- for standard output)."
    ),
]
Unit = Annotated[
    str,
    typer.Option("--unit", "-u", metavar="UNIT", help="A shipped unit or the path of a unit file (.toml)."),
]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="Seed of noise and random events.")]


def console_for(json_path: str | None) -> Console:
    """Where people are told: standard error when standard output carries JSON."""
    return Console(stderr=json_path == "-")


def _print_version(wanted: bool) -> None:
    if wanted:
        from . import __version__

        print(f"st-emulator {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    pass


@app.command()
def run(
    unit: Annotated[
        str, typer.Argument(help="A shipped unit (see `st-emulator units`) or the path of a unit file.")
    ],
    dialect: Annotated[
        str | None,
        typer.Option(
            "--dialect",
            metavar="NAME",
            help="The language on the wire: `pus`, `sagitta`, `nos3` (serial), `canopen` (CAN), or "
            "`module:NAME` of your own. Default: the unit file's.",
        ),
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(
            "--link",
            metavar="LINK",
            help="`pty`, `pty:PATH`, `serial:DEV`, `serial:DEV@BAUD`, "
            "`can:socketcan/vcan0`, `can:slcan/DEV`, each with `@BITRATE` and `,fd` if wanted, or `none`. "
            "Default: pty at speed 1, else none.",
        ),
    ] = None,
    node: Annotated[
        int | None,
        typer.Option(
            "--node",
            metavar="N",
            min=1,
            max=127,
            help="Node number on a CAN bus, so that several units share one. Default: the unit file's.",
        ),
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scenario",
            metavar="FILE",
            help="Trajectory, sky and telecommands at times (TOML). Without one the unit is at rest; on a "
            "line its world starts at the computer's date (UTC), as an OBC sets the real time; with `--link "
            "none` at a fixed date.",
        ),
    ] = None,
    speed: Annotated[
        str,
        typer.Option(
            "--speed", metavar="1|N|max", help="Times real time, or as fast as possible. A live OBC needs 1."
        ),
    ] = "1",
    seed: Seed = None,
    frames: Annotated[
        Path | None,
        typer.Option(
            "--frames", metavar="DIR", help="Recorded frames (PNG, TIFF, FITS) instead of the rendered sky."
        ),
    ] = None,
    hold: Annotated[
        int,
        typer.Option(
            "--hold",
            metavar="N",
            min=1,
            help="Exposures for which each recorded frame stays; 1 for a sequence taken at the unit's rate. "
            "Single frames of different places need time to be lost and found again.",
        ),
    ] = 8,
    journal: Annotated[
        Path | None,
        typer.Option(
            "--journal", metavar="FILE", help="Raw bytes of both directions with virtual times (JSON lines)."
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", metavar="FILE", help="True attitude and stars of each frame (JSON lines)."),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds",
            min=0.001,
            help="Stop after so much virtual time; default: the scenario's duration, else until stopped.",
        ),
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(
            "--store",
            metavar="FILE",
            help="The unit's non-volatile memory. Default: a file of the user's state folder for a run on a "
            "line without a scenario; all other runs, and `none`, start from factory parameters.",
        ),
    ] = None,
    lockstep: Annotated[
        str | None,
        typer.Option(
            "--lockstep",
            metavar="HOST:PORT",
            help="Time comes from a client of a socket on this loopback address (`127.0.0.1:0`: a free "
            "port), step by step; see docs/lockstep.md. Default link then: none.",
        ),
    ] = None,
    control: Annotated[
        str | None,
        typer.Option(
            "--control",
            metavar="HOST:PORT",
            help="In a run paced by the computer: the socket for faults, power, true state, counters.",
        ),
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(
            "--lockstep-token-file",
            "--control-token-file",
            metavar="FILE",
            help="Holds the token that a client has to bring; made, readable by its user alone, where there "
            "is none. Default: a new one in the user's state folder, told when the unit runs.",
        ),
    ] = None,
    attitude: Annotated[
        str | None,
        typer.Option(
            "--attitude",
            metavar="scenario|outside",
            help="Whose the true attitude is: the scenario's, or with --lockstep the client's.",
        ),
    ] = None,
    json_path: Annotated[
        str | None,
        typer.Option(
            "--json",
            metavar="FILE",
            help="Write where the unit is to be reached as JSON when it runs (- for standard output).",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
    supervisor: Annotated[
        int | None,
        typer.Option(
            "--supervisor",
            metavar="FD",
            help="For a program that starts a unit: a socket's descriptor for mode, truth, faults and power. "
            "The unit waits for `begin`, and ends when the other end closes.",
        ),
    ] = None,
) -> None:
    """Run a unit on a line until stopped (Ctrl-C) or until the scenario's end."""
    from .commands.running import RunOptions, run_unit

    run_unit(
        RunOptions(
            unit=unit,
            dialect=dialect,
            link=link,
            node=node,
            scenario=scenario,
            speed=speed,
            seed=seed,
            frames=frames,
            hold=hold,
            journal=journal,
            truth=truth,
            seconds=seconds,
            store=store,
            quiet=quiet,
            supervisor=supervisor,
            lockstep=lockstep,
            control=control,
            token_file=token_file,
            attitude=attitude,
            json_path=json_path,
        )
    )


@app.command()
def demo(
    context: typer.Context,
    unit: Unit = "roja1",
    seconds: Annotated[
        float, typer.Option("--seconds", min=12, max=3600, help="Length of the run, real time.")
    ] = 30.0,
    json_path: Json = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where journal, truth, telemetry and picture go.")
    ] = Path("demo-out"),
    seed: Seed = None,
    link: Annotated[
        str,
        typer.Option(
            "--link",
            metavar="LINK",
            help="`pty`, or a CAN bus: `can:socketcan/vcan0` (./tools/vcan makes one for a command).",
        ),
    ] = "pty",
    dialect: Annotated[
        str | None,
        typer.Option(
            "--dialect",
            metavar="NAME",
            help="Show another language instead: a scripted exchange in virtual time, its octets on the "
            "screen, without link and files (`sagitta`, `nos3`, `canopen`, or `module:NAME` of your own). "
            "Default: the unit file's.",
        ),
    ] = None,
) -> None:
    """Show the main job: a unit and an OBC as two processes over a pseudo-terminal or a CAN bus, in real
    time.
    """
    from .units.profile import load_unit

    of_unit = load_unit(unit).wire.dialect
    language = of_unit if dialect is None else dialect
    if language != "pus":
        for name in ("seconds", "out", "link"):
            if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE":
                raise ConfigurationError(
                    f"--{name}: the exchange in {language} is scripted and has no such option; allowed are "
                    "--unit, --dialect, --seed, --json"
                )
        from .commands.dialect_demo import run_dialect_demo

        raise typer.Exit(run_dialect_demo(unit, language, seed, json_path, console_for(json_path)))
    if of_unit != "pus":
        raise ConfigurationError(
            f"--dialect pus: unit {unit} speaks {of_unit}, and the OBC of the demo speaks pus alone; "
            "allowed is a unit file without wire.dialect, or the demo without --dialect"
        )
    from .commands.demo import run_demo

    raise typer.Exit(run_demo(unit, seconds, json_path, out, seed, console_for(json_path), link))


@app.command()
def campaign(
    name: Annotated[
        str,
        typer.Argument(
            help="`accuracy`, `lost-in-space`, `tracking-rate`, `earth-rate`, `centroids`, `detection`, "
            "`star-quadruples`, or beside a paper's table: `zy3-table3`, `zy3-centroids`, "
            "`catalogue-counts`, `false-stars`, `aps`, `aps-best`, `aps-figure12`.",
        ),
    ],
    unit: Annotated[
        str | None,
        typer.Option(
            "--unit",
            "-u",
            metavar="UNIT",
            help="A shipped unit or the path of a unit file (.toml). Default: roja1, or the one that the "
            "campaign is of.",
        ),
    ] = None,
    n: Annotated[
        int | None, typer.Option("--n", min=1, help="How many cases; each campaign has its own default.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the pointings and of the noise.")] = 1,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Processes; default: one a core.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            "--dask",
            metavar="ADDRESS",
            help="Run the cases on the Dask cluster of this scheduler, as `tcp://127.0.0.1:8786`, whose "
            "workers have the same st-emulator (one thread each: `dask worker --nthreads 1`).",
        ),
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(
            "--results",
            metavar="FILE",
            help="Outcomes of the cases (JSON lines): a run with the same file goes on where it was stopped. "
            "Default: a file of the user's state folder, deleted when the campaign is through.",
        ),
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Begin anew where a stopped run would be gone on with.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw the figures (PNG, SVG, PDF, JPG).")
    ] = None,
    json_path: Json = None,
) -> None:
    """Measure a unit over many skies, and say what falls short. A stopped campaign goes on with the same
    command.
    """
    from .campaigns.registry import CampaignOptions, run_campaign

    options = CampaignOptions(unit, n, seed, workers, dask, results, restart, json_path, plot)
    raise typer.Exit(run_campaign(name, options, console_for(json_path)))


app.command()(budget)


@app.command()
def solve(
    image: Annotated[Path, typer.Argument(help="A recorded frame: PNG, TIFF or FITS.")],
    unit: Unit = "roja1",
    json_path: Json = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture", metavar="FILE", help="Draw the frame with its spots and identified stars (PNG)."
        ),
    ] = None,
) -> None:
    """Run the firmware on one recorded frame, lost in space, and print where it looks."""
    from .commands.solving import solve_image

    raise typer.Exit(solve_image(image, unit, json_path, picture, console_for(json_path)))


@app.command()
def replay(
    journal: Annotated[Path, typer.Argument(help="A journal written by `run --journal`.")],
    json_path: Json = None,
    write: Annotated[
        Path | None, typer.Option("--write", metavar="FILE", help="Write the replayed journal.")
    ] = None,
) -> None:
    """Feed a journal's received bytes to a fresh unit and compare what it sends, byte by byte and time
    by time.
    """
    from .commands.replaying import replay_journal

    raise typer.Exit(replay_journal(journal, json_path, write, console_for(json_path)))


@app.command()
def faults(
    kind: Annotated[
        str | None,
        typer.Argument(metavar="KIND", help="One of them whole, with its settings and an example (TOML)."),
    ] = None,
    seam: Annotated[
        str | None,
        typer.Option(
            "--seam",
            metavar="SEAM",
            help="Those of one seam: `line`, `bus`, `telemetry`, `sensor`, `processor`, `memory`, `clock`, "
            "`power`.",
        ),
    ] = None,
    json_path: Json = None,
) -> None:
    """List the faults that a unit can be given, each with what the OBC must see."""
    from .commands.fault_list import list_faults

    raise typer.Exit(list_faults(kind, seam, json_path, console_for(json_path)))


@app.command()
def prepare() -> None:
    """Compile the kernels and build the star tables of the shipped units, so that no first run waits."""
    from .commands.warm_up import warm_up
    from .units.profile import load_unit, unit_names

    console = Console(stderr=True)
    for name in unit_names():
        with console.status(f"preparing {name} (compiled once, then kept)"):
            warm_up(load_unit(name))
    console.print("kernels and star tables are ready")


@app.command()
def units(json_path: Json = None) -> None:
    """List the shipped units."""
    from .report import require_json_path, write_json
    from .units.profile import load_unit, unit_names

    require_json_path(json_path)
    profiles = [load_unit(name) for name in unit_names()]
    if json_path != "-":
        for profile in profiles:
            print(f"{profile.name:14} {profile.unit.title}")
    write_json(
        json_path, {"units": [{"name": p.name, "title": p.unit.title, "apid": p.apid} for p in profiles]}, []
    )


def _mount_obc() -> None:
    from .obc.cli import obc_app

    app.add_typer(obc_app, name="obc")


def main() -> None:
    """Entry point: a problem that the user can mend is one line on standard error and exit status 2."""
    _mount_obc()
    from .links import LinkError
    from .world.recorded import RecordedFrameError
    from .world.sampled import BeyondTruthError

    try:
        app(prog_name="st-emulator")
    except (BeyondTruthError, ConfigurationError, LinkError, RecordedFrameError) as error:
        _refuse(str(error))
    except BrokenPipeError:
        sys.exit(1)
    except OSError as error:  # of a file or folder that nothing above knows by name
        where = f"{error.filename}: " if error.filename is not None else ""
        _refuse(f"{where}{error.strerror or error}")


def _refuse(message: str) -> NoReturn:
    print("st-emulator:", " ".join(message.split()), file=sys.stderr)
    sys.exit(2)
