"""``st-emulator faults``: what can be put in, and what an OBC must see then."""

from __future__ import annotations

from dataclasses import asdict

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.syntax import Syntax
from rich.table import Table

from ..errors import ConfigurationError
from ..faults.catalogue import FAULTS
from ..faults.fault import FaultKind
from ..faults.listing import (
    SEAMS,
    Setting,
    as_table,
    default_text,
    example,
    is_instant,
    kinds_of_seam,
    own_settings,
    settings_of_all,
    where,
)
from ..report import require_json_path, write_json


def list_faults(kind_name: str | None, seam: str | None, json_path: str | None, console: Console) -> int:
    """Print the list, those of a seam, or one kind whole."""
    require_json_path(json_path)
    kinds = _chosen(kind_name, seam)
    if kind_name is None:
        _show_list(kinds, console)
    else:
        _show_whole(kinds[0], console)
    write_json(
        json_path,
        {
            "faults": [as_table(kind) for kind in kinds],
            "settings_of_all": [asdict(setting) for setting in settings_of_all()],
        },
        [],
    )
    return 0


def _chosen(kind_name: str | None, seam: str | None) -> list[FaultKind]:
    if seam is not None and seam not in SEAMS:
        raise ConfigurationError(f"--seam: found {seam!r}; allowed are {', '.join(SEAMS)}")
    kinds = list(FAULTS.values()) if seam is None else kinds_of_seam(seam)
    if kind_name is None:
        return kinds
    named = [kind for kind in kinds if kind.name == kind_name]
    if not named:
        raise ConfigurationError(
            f"KIND: found {kind_name!r}; allowed are {', '.join(sorted(kind.name for kind in kinds))}"
        )
    return named


def _show_list(kinds: list[FaultKind], console: Console) -> None:
    for seam, meaning in SEAMS.items():
        of_seam = [kind for kind in kinds if kind.seam == seam]
        if not of_seam:
            continue
        console.print(f"\n[bold]{seam}[/bold]: {meaning}")
        table = Table(show_lines=True, expand=True)
        table.add_column("kind", min_width=max(len(kind.name) for kind in of_seam))
        table.add_column("what happens", ratio=3)
        table.add_column("what the OBC must see", ratio=5)
        for kind in of_seam:
            table.add_row(f"{kind.name}\n({where(kind)})", escape(kind.what), escape(kind.obc_sees))
        console.print(table)
    console.print(
        "\nSettings, their ranges and an example: st-emulator faults KIND. They stand in a scenario's "
        "\\[\\[faults]], or are put in live (docs/faults_guide.md)."
    )


def _show_whole(kind: FaultKind, console: Console) -> None:
    console.print(f"[bold]{kind.name}[/bold] ({where(kind)})")
    for title, text in (
        ("What happens", kind.what),
        ("What the OBC must see", kind.obc_sees),
        ("Afterwards", kind.afterwards),
    ):
        console.print(f"\n[bold]{title}[/bold]")
        console.print(Padding(escape(text), (0, 0, 0, 2)))
    own = own_settings(kind)
    if own:
        console.print()
        console.print(_settings_table("Its settings", own))
    console.print()
    title = "Settings of all faults" + (
        " (it is over at once, an end changes nothing)" if is_instant(kind) else ""
    )
    console.print(_settings_table(title, settings_of_all()))
    console.print("\n[bold]In a scenario[/bold]")
    console.print(Padding(Syntax(example(kind), "toml", background_color="default"), (0, 0, 0, 2)))


def _settings_table(title: str, settings: list[Setting]) -> Table:
    table = Table(title=title, title_justify="left", expand=True)
    for head, ratio in (("key", 2), ("allowed", 3), ("default", 2), ("meaning", 5)):
        table.add_column(head, ratio=ratio, overflow="fold")
    for setting in settings:
        table.add_row(
            setting.name, escape(setting.allowed), escape(default_text(setting)), escape(setting.meaning)
        )
    return table


def fault_chapter() -> str:
    """The chapter of the interface document, Markdown."""
    lines = [
        "A unit can be broken on purpose, by a scenario's `[[faults]]`, from Python and live: "
        "[faults_guide.md](faults_guide.md) says how, [faults.md](faults.md) what was seen on the wire when "
        "each was put in. Times are virtual, from power-on. A kind is named by the seam where it enters.",
        "",
        "Every fault has these settings:",
        "",
        *_markdown(settings_of_all()),
    ]
    for seam, meaning in SEAMS.items():
        kinds = kinds_of_seam(seam)
        if kinds:
            lines += [f"### Faults: {seam}", "", f"{meaning[0].upper()}{meaning[1:]}.", ""]
        for kind in kinds:
            lines += [f"#### {kind.name}", "", f"On: {where(kind)}. {kind.what}", ""]
            lines += [f"**What the OBC must see.** {kind.obc_sees}", ""]
            lines += [f"**Afterwards.** {kind.afterwards}", ""]
            own = own_settings(kind)
            lines += _markdown(own) if own else ["No settings of its own.", ""]
    return "\n".join(lines).rstrip() + "\n"


def _markdown(settings: list[Setting]) -> list[str]:
    rows = ["| key | allowed | default | meaning |", "|---|---|---|---|"]
    for one in settings:
        cells = (f"`{one.name}`", one.allowed, default_text(one), one.meaning)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return [*rows, ""]
