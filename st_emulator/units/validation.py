"""TOML tables to validated models; every failure is one line that names file, key and what is allowed."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError

from ..errors import ConfigurationError

MOST_SHOWN = 60  # characters of a wrong value
Model = TypeVar("Model", bound="Section")
Schema = dict[str, Any]
Switch = Annotated[bool, Field(strict=True)]
"""true or false: no text or number that could be taken for one of them."""


class Section(BaseModel):
    """A table of a unit or scenario file: unknown keys are errors, so that a typing slip is never ignored."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    _origin: str = PrivateAttr(default="")

    @property
    def origin(self) -> str:
        """The file that a whole unit or scenario came from, for errors; empty when it came from none."""
        return self._origin


def read_text(path: Path, kind: str) -> str:
    """The text of a file that the user named; ``kind`` says what it ought to be, "a unit file"."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise ConfigurationError(f"{path}: cannot be read: {reason}; {kind} is a TOML text file") from error


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """The tables of a TOML text; ``where`` names it in errors."""
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else error
        raise ConfigurationError(f"{where}: not valid TOML: {reason}") from error


def validate(model: type[Model], data: Any, where: str, *, inside: str = "") -> Model:
    """Build ``model`` from ``data``. ``inside``: a key that nobody wrote, left out of what errors say.

    Raises:
        ConfigurationError: one line with ``where``, the key and what is allowed. Of several failures an
            unknown key is told first: it is mostly a slip that makes another key missing.
    """
    try:
        made = model.model_validate(data)
    except ValidationError as error:
        problems = error.errors()
        first = next((item for item in problems if item["type"] == "extra_forbidden"), problems[0])
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        text = _problem(model.model_json_schema(by_alias=True), data, dict(first))
        if inside:
            text = text.removeprefix(f"{inside}.").removeprefix(f"{inside}: ")
        raise ConfigurationError(f"{where}: {text}{more}") from error
    made._origin = where
    return made


def allowed_values(model: type[BaseModel]) -> dict[str, str]:
    """What each key of a table may be, in the words of the errors; ``none`` where it may be left out."""
    schema = model.model_json_schema(by_alias=True)
    return {key: _allowed(schema, _resolved(schema, node)) for key, node in schema["properties"].items()}


def _problem(schema: Schema, data: Any, error: dict[str, Any]) -> str:
    location: tuple[int | str, ...] = error["loc"]
    kind, found = error["type"], error["input"]
    node = _node(schema, location)
    key = _key(data, location, last_is_key=kind in ("missing", "extra_forbidden"))
    if kind == "extra_forbidden":
        table = _table(schema, _node(schema, location[:-1]) or {})
        return f"{key}: is not a known key; allowed are {', '.join(table.get('properties', {}))}"
    if kind == "missing":
        return f"{key}: is missing; allowed is {_allowed(schema, node)}"
    if kind in ("union_tag_invalid", "union_tag_not_found") and node is not None:
        choice = node["discriminator"]
        tags = ", ".join(choice["mapping"])
        tag_key = f"{key}.{choice['propertyName']}"
        if kind == "union_tag_not_found":
            return f"{tag_key}: is missing; allowed are {tags}"
        return f"{tag_key}: found {_shown(found.get(choice['propertyName']))}; allowed are {tags}"
    if kind == "value_error":
        message = str(error["msg"]).removeprefix("Value error, ")
        return f"{key}: {message}" if location else message  # of the whole file: it names its key itself
    return f"{key}: found {_shown(found)}; allowed is {_allowed(schema, node)}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else text[: MOST_SHOWN - 3] + "..."


def _key(data: Any, location: tuple[int | str, ...], *, last_is_key: bool) -> str:
    """The key as the file's author wrote it: pydantic's location without the tags of unions."""
    parts = []
    for number, part in enumerate(location):
        if isinstance(data, dict) and part in data:
            data = data[part]
        elif isinstance(data, (list, tuple)) and isinstance(part, int):
            data = data[part] if part < len(data) else None
        elif not (last_is_key and number == len(location) - 1):
            continue
        text = str(part)
        parts.append(text if text.isprintable() else repr(text))
    return ".".join(parts) or "(whole file)"


def _resolved(schema: Schema, node: Schema) -> Schema:
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rsplit("/", 1)[-1]]
    choices = [choice for choice in node.get("anyOf", ()) if choice.get("type") != "null"]
    return _resolved(schema, choices[0]) if len(choices) == 1 else node


def _table(schema: Schema, node: Schema) -> Schema:
    """The table among what a value may be."""
    choices = (_resolved(schema, choice) for choice in node.get("anyOf", ()))
    return next((choice for choice in choices if "properties" in choice), node)


def _node(schema: Schema, location: tuple[int | str, ...]) -> Schema | None:
    """The part of a JSON schema that a pydantic location leads to."""
    node = _resolved(schema, schema)
    for part in location:
        if part in node.get("properties", {}):
            node = node["properties"][part]
        elif part in node.get("discriminator", {}).get("mapping", {}):
            node = {"$ref": node["discriminator"]["mapping"][part]}
        elif isinstance(part, int) and "prefixItems" in node:
            node = node["prefixItems"][part] if part < len(node["prefixItems"]) else {}
        elif isinstance(part, int) and "items" in node:
            node = node["items"]
        elif isinstance(node.get("additionalProperties"), dict):
            node = node["additionalProperties"]
        elif "anyOf" in node:
            tables = [_resolved(schema, choice) for choice in node["anyOf"]]
            # pydantic names the member of a union that it tried, or the key in the only table of it
            node = next((t["properties"][part] for t in tables if part in t.get("properties", {})), node)
        else:
            return None
        node = _resolved(schema, node)
    return node


def _allowed(schema: Schema, node: Schema | None) -> str:
    """What a JSON schema allows, in words."""
    if not node:
        return "a value of another kind"
    if "const" in node:
        return repr(node["const"])
    if "enum" in node:
        return "one of " + ", ".join(repr(choice) for choice in node["enum"])
    if "discriminator" in node:
        choice = node["discriminator"]
        return f"a table with {choice['propertyName']} = {' or '.join(choice['mapping'])}"
    if "anyOf" in node:
        choices = [choice for choice in node["anyOf"] if choice.get("type") != "null"]
        return " or ".join(_allowed(schema, _resolved(schema, choice)) for choice in choices)
    kind = node.get("type")
    if kind in ("integer", "number"):
        return ("a whole number" if kind == "integer" else "a number") + _range(node)
    if kind == "boolean":
        return "true or false"
    if kind == "string":
        if node.get("format") == "date-time":
            return "a date and time with its zone, such as 2026-01-15T00:00:00Z"
        return f"text that matches {node['pattern']}" if "pattern" in node else "text"
    if kind == "array":
        if "prefixItems" in node:
            items = [_allowed(schema, _resolved(schema, item)) for item in node["prefixItems"]]
            return f"a list of {len(items)}: {', '.join(items)}"
        least = f" with at least {node['minItems']}" if node.get("minItems") else ""
        return f"a list{least}, each {_allowed(schema, _resolved(schema, node.get('items', {})))}"
    if "properties" in node:
        return f"a table with the keys {', '.join(node['properties'])}"
    return "a table"


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.15g}"


def _range(node: Schema) -> str:
    parts = [
        f"{words} {_number(node[name])}"
        for name, words in (
            ("minimum", "from"),
            ("exclusiveMinimum", "over"),
            ("maximum", "to"),
            ("exclusiveMaximum", "and under" if "minimum" in node else "under"),
        )
        if name in node
    ]
    return " " + " ".join(parts) if parts else ""
