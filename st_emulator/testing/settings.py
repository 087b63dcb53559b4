"""Which unit a test gets, on which link, in which time: from options, the ini file and markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from ..errors import ConfigurationError
from ..links import LinkError, LinkSpecification, parse_link

DEFAULT_UNIT = "roja1"
VIRTUAL = "virtual"
LINK_FORMS = (
    "memory, memory:can, memory:can,fd, pty, pty:PATH, serial:DEVICE[@BAUD] or "
    "can:INTERFACE/CHANNEL[@BITRATE][,fd]"
)
ANY_LINK = {"can": "memory:can", "serial": "memory"}
"""What a marker may name instead of a link, and the link in memory of that kind."""
Place = Literal["memory", "process", "there"]
"""Where a unit is: in this process, in one that is started for it, or there already (hardware)."""


@dataclass(frozen=True)
class BenchLink:
    """A link as ``--st-link`` names it.

    ``specification``: what st-emulator's other commands call it; None: in memory. ``can``, ``fd``: it is a
    CAN bus, with CAN FD.
    """

    text: str
    place: Place
    specification: LinkSpecification | None
    can: bool
    fd: bool


def parse_bench_link(text: str, present: bool = False) -> BenchLink:
    """What ``--st-link`` says; ``present``: the unit is there already, whatever the link is.

    Of a serial port and of a CAN interface with a controller it is there in any case: that is hardware.

    Raises:
        ConfigurationError: one line with what is allowed.
    """
    if text in ("memory", "memory:"):
        return BenchLink(text, "memory", None, False, False)
    if text in ("memory:can", "memory:can,fd"):
        return BenchLink(text, "memory", None, True, text.endswith(",fd"))
    try:
        specification = parse_link("pty" if text == "pty:" else text)
    except LinkError as error:
        raise ConfigurationError(
            f"--st-link {text}: {error}; for tests also memory and memory:can"
        ) from error
    if specification.kind == "none":
        raise ConfigurationError(f"--st-link {text}: has no other end; allowed are {LINK_FORMS}")
    there = present or specification.kind == "serial" or _is_controller(specification)
    place: Place = "there" if there else "process"
    return BenchLink(text, place, specification, specification.kind == "can", specification.fd)


def marked_link(text: str, given: BenchLink, present: bool = False) -> BenchLink:
    """The link of a test that is marked with ``st_link``, where the run as a whole is on ``given``.

    ``can`` and ``serial`` mean any of that kind: the given one if it is, else one in memory. Hardware stays
    what it is: see :func:`lacking`.

    Raises:
        ConfigurationError: no link.
    """
    if given.place == "there":
        return given
    if text in ANY_LINK:
        wanted = parse_bench_link(ANY_LINK[text])
        return given if given.can == wanted.can else wanted
    return parse_bench_link(text, present)


def lacking(text: str, given: BenchLink) -> str | None:
    """What a test that is marked with ``st_link`` misses on hardware; None: nothing."""
    if given.place != "there":
        return None
    wanted = parse_bench_link(ANY_LINK.get(text, text))
    if wanted.specification is None and text not in ANY_LINK:
        return "virtual time"
    if wanted.can == given.can:
        return None
    return "a CAN bus" if wanted.can else "a serial line"


def _is_controller(specification: LinkSpecification) -> bool:
    """Whether a CAN interface is hardware, with a unit on it."""
    if specification.kind != "can":
        return False
    if specification.interface != "socketcan":
        return specification.interface == "slcan"
    from ..links.network_interface import network_interface

    assert specification.path is not None
    found = network_interface(specification.path)
    return found is not None and found.is_can and found.kind not in ("vcan", "vxcan", "")


def parse_bench_speed(text: str | float, link: BenchLink) -> float | None:
    """Times real time, at most; None: virtual time.

    Raises:
        ConfigurationError: no speed, or none of this link.
    """
    if link.place != "memory":
        if text in (VIRTUAL, "") or float_of(text) == 1:
            return 1.0
        raise ConfigurationError(f"--st-speed {text}: a unit on {link.text} keeps real time; allowed is 1")
    if text in (VIRTUAL, ""):
        return None
    speed = float_of(text)
    if speed is None or not 0.01 <= speed <= 1000:
        raise ConfigurationError(
            f"--st-speed {text}: allowed are {VIRTUAL}, or a number from 0.01 to 1000 of times real time"
        )
    return speed


def node_number(text: str | int | None) -> int | None:
    """A node number of a CAN bus; None: none is given.

    Raises:
        ConfigurationError: it is none.
    """
    if text in (None, ""):
        return None
    number = float_of(str(text))
    if number is None or number not in range(1, 128):
        raise ConfigurationError(f"--st-node {text}: allowed is a whole number from 1 to 127")
    return int(number)


def float_of(text: str | float) -> float | None:
    """A number; None: it is none."""
    try:
        return float(text)
    except ValueError:
        return None


@dataclass(frozen=True)
class UnitSettings:
    """What a test's unit is.

    ``unit``: name or file. ``node``: on a CAN bus; None: the unit file's in memory and on hardware, a free
    one on a bus that others may use too. ``scenario``: tables of a scenario, ``scenario_where`` what errors
    call them; None: none was asked for. ``off``: power has not come on yet when the test begins.
    """

    link: BenchLink
    unit: str = DEFAULT_UNIT
    dialect: str | None = None
    speed: float | None = None
    node: int | None = None
    scenario: Mapping[str, Any] | None = None
    scenario_where: str = "scenario"
    faults: tuple[Mapping[str, Any], ...] = ()
    off: bool = False
    emulator_arguments: Mapping[str, Any] = field(default_factory=dict)

    def scenario_table(self) -> dict[str, Any] | None:
        """The scenario with the faults in it; None: neither was asked for."""
        if self.scenario is None and not self.faults:
            return None
        table = dict(self.scenario or {})
        if self.faults:
            table["faults"] = [*table.get("faults", ()), *map(dict, self.faults)]
        return table

    def changed(self, **figures: Any) -> UnitSettings:
        """The same but for these."""
        return replace(self, **figures)


def scenario_file(path: Path) -> dict[str, Any]:
    """The tables of a scenario file.

    Raises:
        ConfigurationError: it cannot be read, or is no TOML.
    """
    from ..units.validation import parse_toml, read_text

    return parse_toml(read_text(path, "a scenario"), str(path))


def validated_scenario(settings: UnitSettings) -> Any:
    """The :class:`~st_emulator.bench.scenario.Scenario` that is asked for; None: none is.

    Raises:
        ConfigurationError: names the key and what is allowed.
    """
    from ..bench.scenario import Scenario
    from ..units.validation import validate

    table = settings.scenario_table()
    return None if table is None else validate(Scenario, table, settings.scenario_where)
