"""The dialects that there are, and those of users."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError
from ..units.profile import UnitProfile
from ..units.validation import Section, validate
from .canopen.definition import CANOPEN
from .dialect import DialectDefinition
from .nos3.definition import NOS3
from .own_module import imported
from .pus.definition import PUS
from .sagitta.definition import SAGITTA

SHIPPED: tuple[DialectDefinition[Any], ...] = (PUS, CANOPEN, NOS3, SAGITTA)


def dialect_names() -> list[str]:
    """Names of the shipped dialects."""
    return [definition.name for definition in SHIPPED]


def dialect_named(name: str, beside: Path | None = None) -> DialectDefinition[Any]:
    """A shipped dialect by its name, or a user's by ``module:NAME``: the module is imported, and NAME in it
    is a :class:`DialectDefinition`.

    The module is looked for in the folder ``beside`` (that of the file which names it), then on the Python
    path, then in the current folder; ``sys.path`` stays as it is.

    Raises:
        ConfigurationError: no such dialect; one line that says what is allowed.
    """
    for definition in SHIPPED:
        if definition.name == name:
            return definition
    return _own(name, None if beside is None else beside.resolve(), Path.cwd())


@cache
def _own(name: str, beside: Path | None, current: Path) -> DialectDefinition[Any]:
    """A user's dialect. Failures are not kept: a module that was mended is tried again."""
    module_name, _, attribute = name.partition(":")
    parts = module_name.split(".")
    if not attribute.isidentifier() or not all(part.isidentifier() for part in parts):
        raise ConfigurationError(
            f"found {name!r}; allowed are {', '.join(dialect_names())}, or module:NAME for a dialect of your "
            "own, for instance my_dialect.definition:DIALECT"
        )
    module = imported(module_name, beside, current)
    found = getattr(module, attribute, None)
    if isinstance(found, DialectDefinition):
        if found.name in dialect_names():
            raise ConfigurationError(
                f"{name} calls itself {found.name!r}, as a shipped dialect; allowed is any other name"
            )
        return found
    defined = [key for key, value in vars(module).items() if isinstance(value, DialectDefinition)]
    there_is = f"there is {', '.join(defined)}" if defined else "there is none in it"
    wrong = f"is no DialectDefinition but a {type(found).__name__}"
    if not hasattr(module, attribute):
        wrong = "is not there"
    raise ConfigurationError(
        f"{attribute} in module {module_name} ({getattr(module, '__file__', None)}) {wrong}; allowed is the "
        f"name of a DialectDefinition, {there_is}"
    )


def dialect_of(profile: UnitProfile) -> DialectDefinition[Any]:
    """The dialect that a unit speaks; a module of the user's own may lie beside the unit file.

    Raises:
        ConfigurationError: names the file, the key and what is allowed.
    """
    try:
        return dialect_named(profile.wire.dialect, _folder(profile))
    except ConfigurationError as error:
        raise ConfigurationError(f"{_where(profile)}: wire.dialect: {error}") from error


def with_dialect(profile: UnitProfile, name: str | None) -> UnitProfile:
    """The unit speaking another dialect, that of ``--dialect``; None: its own.

    Raises:
        ConfigurationError: no such dialect.
    """
    if name is None:
        return profile
    try:
        dialect_named(name, _folder(profile))
    except ConfigurationError as error:
        raise ConfigurationError(f"--dialect: {error}") from error
    return profile.model_copy(update={"wire": profile.wire.model_copy(update={"dialect": name})})


def settings_of(profile: UnitProfile) -> Section:
    """The settings of a unit's dialect: its table ``[dialects.NAME]``, validated.

    Raises:
        ConfigurationError: names the file, the key and what is allowed. Also for a table of a name that
            nobody has while the dialect's own is missing: a typing slip that would be ignored else.
    """
    definition = dialect_of(profile)
    if definition.name not in profile.dialects and definition.settings.model_fields:
        for name in profile.dialects:
            if name not in dialect_names():
                raise ConfigurationError(
                    f"{_where(profile)}: dialects.{name}: is not the name of the dialect that wire.dialect "
                    f"chooses; allowed are {', '.join(dict.fromkeys([definition.name, *dialect_names()]))}"
                )
    settings: Section = validate(
        definition.settings,
        profile.dialects.get(definition.name, {}),
        f"{_where(profile)}: dialects.{definition.name}",
    )
    return settings


def require_wire(profile: UnitProfile, can: bool, *, by_option: bool = False) -> None:
    """Refuse a wire that the unit's dialect does not have; ``can``: a CAN bus, else a serial line.
    ``by_option``: the dialect is that of ``--dialect``, not of the unit file, and errors say so.

    Raises:
        ConfigurationError: names the file, the key and what is allowed.
    """
    definition = dialect_of(profile)
    where = "--dialect" if by_option else f"{_where(profile)}: wire.dialect"
    if can and definition.on_can is None:
        raise ConfigurationError(
            f"{where}: {definition.name} has no CAN bus; allowed is a link that is a "
            "serial line (pty, serial:DEV, none), or another dialect"
        )
    if not can and definition.on_serial is None:
        raise ConfigurationError(
            f"{where}: {definition.name} has no serial line; allowed is a link that "
            "is a CAN bus (can:INTERFACE/CHANNEL), or another dialect"
        )


def _where(profile: UnitProfile) -> str:
    return profile.origin or profile.name


def _folder(profile: UnitProfile) -> Path | None:
    """The folder of the file that a unit came from."""
    return Path(profile.origin).parent if profile.origin else None
