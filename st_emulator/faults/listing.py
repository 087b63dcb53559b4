"""The list of faults for people and programs: what each does, its settings, an example."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from ..units.validation import allowed_values
from .catalogue import FAULTS
from .chance import OF_ALL
from .fault import Fault, FaultKind, FaultSettings

SEAMS: Final[dict[str, str]] = {
    "line": "octets and messages between unit and OBC",
    "bus": "frames of the CAN bus",
    "telemetry": "what the unit tells of its attitude",
    "sensor": "frames between the sensor and the firmware",
    "processor": "the processor that works on them",
    "memory": "what lies in the memories, and what is being written",
    "clock": "the on-board time",
    "power": "the power supply",
}


@dataclass(frozen=True)
class Setting:
    """One key of a fault's table. ``default``: None where it may be left out for none, or must be given
    (``required``)."""

    name: str
    allowed: str
    default: Any
    required: bool
    meaning: str


def _settings(model: type[FaultSettings], names: Sequence[str]) -> list[Setting]:
    allowed = allowed_values(model)
    found = []
    for name in names:
        field = model.model_fields[name]
        required = field.is_required()
        description = field.description or next(
            (text for part in field.metadata if (text := getattr(part, "description", None))), ""
        )
        description = description or _schema_description(model, name)
        found.append(Setting(name, allowed[name], None if required else field.default, required, description))
    return found


def _schema_description(model: type[FaultSettings], name: str) -> str:
    """A description that stands beside a type within a union."""
    node = model.model_json_schema()["properties"][name]
    return next((str(one["description"]) for one in node.get("anyOf", ()) if "description" in one), "")


def own_settings(kind: FaultKind) -> list[Setting]:
    """The settings that other faults do not have."""
    return _settings(
        kind.settings, [name for name in kind.settings.model_fields if name not in OF_ALL and name != "kind"]
    )


def settings_of_all() -> list[Setting]:
    """The settings that every fault has."""
    return _settings(FaultSettings, [name for name in FaultSettings.model_fields if name != "kind"])


def is_instant(kind: FaultKind) -> bool:
    """Whether it is over when it has begun."""
    return isinstance(kind.make, type) and issubclass(kind.make, Fault) and kind.make.instant


def example(kind: FaultKind) -> str:
    """A table of a scenario file: what must be given, and the defaults of the rest as remarks."""
    lines = ["[[faults]]", f'kind = "{kind.name}"', "start_s = 10.0"]
    if not is_instant(kind):
        lines.append("duration_s = 2.0")
    for setting in own_settings(kind):
        if setting.required:
            lines.append(f"{setting.name} = {_toml(_some(kind, setting.name))} # {setting.allowed}")
        elif setting.default is None:
            lines.append(f"# {setting.name} = ... # {setting.allowed}")
        else:
            lines.append(f"# {setting.name} = {_toml(setting.default)} # {setting.allowed}")
    return "\n".join(lines) + "\n"


def _some(kind: FaultKind, name: str) -> Any:
    """A value that is allowed for a setting that must be given."""
    node = kind.settings.model_json_schema()["properties"][name]
    if "enum" in node:
        return node["enum"][0]
    if "const" in node:
        return node["const"]
    if node.get("type") in ("integer", "number"):
        low, high = node.get("minimum", node.get("exclusiveMinimum", 0)), node.get("maximum")
        value = low + 1 if high is None or low + 1 <= high else high
        return value if node["type"] == "integer" else float(value)
    return True


def _toml(value: Any) -> str:
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return json.dumps(value)


def as_table(kind: FaultKind) -> dict[str, Any]:
    """All of it, for JSON."""
    return {
        "kind": kind.name,
        "seam": kind.seam,
        "what": kind.what,
        "obc_sees": kind.obc_sees,
        "afterwards": kind.afterwards,
        "instant": is_instant(kind),
        "wires": list(kind.wires),
        "dialects": None if kind.dialects is None else list(kind.dialects),
        "settings": [asdict(setting) for setting in own_settings(kind)],
        "example": example(kind),
    }


def where(kind: FaultKind) -> str:
    """On which wires and in which languages there is such a thing."""
    wires = {"serial": "serial line", "can": "CAN bus"}
    text = " and ".join(wires[wire] for wire in kind.wires)
    return text if kind.dialects is None else f"{text}; {', '.join(kind.dialects)}"


def default_text(setting: Setting) -> str:
    """What holds where the key is left out."""
    if setting.required:
        return "must be given"
    return "none" if setting.default is None else _toml(setting.default).strip('"')


def kinds_of_seam(seam: str) -> list[FaultKind]:
    return [kind for kind in FAULTS.values() if kind.seam == seam]
