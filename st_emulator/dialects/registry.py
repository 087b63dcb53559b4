"""The dialects that there are, and those of users."""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

from ..errors import ConfigurationError
from ..units.profile import UnitProfile
from ..units.validation import Section, validate
from .dialect import DialectDefinition
from .pus.definition import PUS

SHIPPED: tuple[DialectDefinition[Any], ...] = (PUS,)


def dialect_names() -> list[str]:
    """Names of the shipped dialects."""
    return [definition.name for definition in SHIPPED]


@cache
def dialect_named(name: str) -> DialectDefinition[Any]:
    """A shipped dialect by its name, or a user's by ``module:NAME``: the module is imported, and NAME in it
    is a :class:`DialectDefinition`.

    Raises:
        ConfigurationError: no such dialect.
    """
    for definition in SHIPPED:
        if definition.name == name:
            return definition
    module, separator, attribute = name.partition(":")
    if not separator:
        raise ConfigurationError(
            f"dialect '{name}': shipped are {', '.join(dialect_names())}; a dialect of your own is named "
            "module:NAME, for instance my_project.my_dialect:DIALECT"
        )
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigurationError(f"dialect '{name}': cannot be imported: {error}") from error
    if not isinstance(found, DialectDefinition):
        raise ConfigurationError(f"dialect '{name}': is no DialectDefinition but a {type(found).__name__}")
    return found


def dialect_of(profile: UnitProfile) -> DialectDefinition[Any]:
    """The dialect that a unit speaks."""
    try:
        return dialect_named(profile.wire.dialect)
    except ConfigurationError as error:
        raise ConfigurationError(f"{profile.origin or profile.name}: wire.dialect: {error}") from error


def settings_of(profile: UnitProfile) -> Section:
    """The settings of a unit's dialect: its table ``[dialects.NAME]``, validated.

    Raises:
        ConfigurationError: names the file, the key and what is allowed.
    """
    definition = dialect_of(profile)
    given = profile.dialects.get(definition.name, {})
    where = f"{profile.origin or profile.name}: dialects.{definition.name}"
    settings: Section = validate(definition.settings, given, where)
    return settings
