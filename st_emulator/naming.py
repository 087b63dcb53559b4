"""Names for what travels as numbers, and numbers for what a person writes as names.

Everything comes from the message table; nothing here lists messages, modes or parameters a second time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from enum import IntEnum, IntFlag
from typing import Any

from .protocol.errors import LocalProtocolError
from .protocol.pus.enumerations import EventId, FunctionId, HousekeepingId, ParameterId
from .protocol.pus.events import EVENTS
from .protocol.pus.fields import Data, Element, Field, Repeated, Switched
from .protocol.pus.packets import CucTime
from .protocol.pus.registry import REGISTRY
from .tai import tai_ns_from_utc


def member(choices: type[IntEnum] | type[IntFlag], text: str) -> int:
    """Number of the member called `text` (any case, - for _) or written as a number; flags joined by |.

    ValueError names what is allowed.
    """
    if issubclass(choices, IntFlag):
        bits = 0
        for part in text.split("|"):
            bits |= _one(choices, part)
        return bits
    return _one(choices, text)


def _one(choices: type[IntEnum] | type[IntFlag], text: str) -> int:
    name = text.strip().upper().replace("-", "_")
    if name in choices.__members__:
        return int(choices.__members__[name])
    try:
        return int(text, 0)
    except ValueError:
        names = ", ".join(entry.lower() for entry in choices.__members__)
        raise ValueError(f"{text!r} is none of {names}") from None


def name_of(choices: type[IntEnum] | type[IntFlag], number: int) -> str:
    """Name of `number`; flags joined by |, "-" for none; the number itself when it has no name."""
    if issubclass(choices, IntFlag):
        names = [flag.name or "" for flag in choices if number & flag]
        known = sum(int(flag) for flag in choices)
        rest = [f"0x{number & ~known:X}"] if number & ~known else []
        return "|".join(names + rest) or "-"
    try:
        return str(choices(number).name)
    except ValueError:
        return str(number)


def resolve_fields(message: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """`fields` of a telecommand with names and texts replaced by what the encoder takes.

    Enumeration members by name, numbers as text (also 0x..), octets as hexadecimal text, lists as text with
    commas, times as aware datetime or ISO text. Arguments of a function may stand beside `function_id`
    instead of in `arguments`. What cannot be understood is left for the encoder to refuse, except a wrong
    name: LocalProtocolError.
    """
    if message not in REGISTRY:
        return dict(fields)
    elements = REGISTRY.by_name(message).fields
    return _group(message, "", elements, fields)


def _group(message: str, path: str, elements: Sequence[Element], values: Mapping[str, Any]) -> dict[str, Any]:
    known = {element.name for element in elements}
    result = {name: value for name, value in values.items() if name in known}
    strays = {name: value for name, value in values.items() if name not in known}
    for element in elements:
        if isinstance(element, Switched):
            if strays and element.name not in result:
                result[element.name], strays = strays, {}
            if element.name in result:
                result[element.name] = _switched(message, path, element, result)
        elif element.name in result:
            result[element.name] = _value(message, path + element.name, element, result[element.name])
    return result | strays


def _switched(message: str, path: str, element: Switched, group: Mapping[str, Any]) -> Any:
    value = group[element.name]
    case = element.cases.get(group.get(element.on, -1)) if isinstance(group.get(element.on), int) else None
    if case is None:
        return value
    if case.single:
        return _value(message, path + element.name, case.fields[0], value)
    if isinstance(value, Mapping):
        return _group(message, f"{path}{element.name}.", case.fields, value)
    return value


def _value(message: str, path: str, element: Element, value: Any) -> Any:
    if isinstance(element, Repeated):
        if isinstance(value, str):
            value = [part for part in value.split(",") if part]
        if not isinstance(value, (list, tuple, set, frozenset)):
            return value
        if element.single:
            return [_value(message, f"{path}[{n}]", element.items[0], item) for n, item in enumerate(value)]
        return [
            _group(message, f"{path}[{n}].", element.items, item) if isinstance(item, Mapping) else item
            for n, item in enumerate(value)
        ]
    if isinstance(element, Data):
        return _octets(value) if isinstance(value, str) else value
    return _number(message, path, element, value) if isinstance(element, Field) else value


def _octets(text: str) -> bytes | str:
    try:
        return bytes.fromhex(text)
    except ValueError:
        return text


def _number(message: str, path: str, field: Field, value: Any) -> Any:
    if isinstance(value, datetime) and field.type.kind == "time":
        return CucTime.from_ns(tai_ns_from_utc(value))
    if not isinstance(value, str):
        return value
    if field.choices is not None:
        try:
            return member(field.choices, value)
        except ValueError:
            raise LocalProtocolError(message, path, value, field.allowed()) from None
    try:
        if field.type.kind == "integer":
            return int(value, 0)
        if field.type.kind == "float":
            return float(value)
        if field.type.kind == "time":
            return CucTime.from_ns(tai_ns_from_utc(datetime.fromisoformat(value)))
    except ValueError:
        pass
    return value


def telecommand_label(message: str, fields: Mapping[str, Any], apid: int, sequence_count: int) -> str:
    """A sent telecommand for a person: `function START_ACQUISITION TC[8,1] (APID 0x64, count 5)`."""
    definition = REGISTRY.by_name(message)
    which = ""
    if "function_id" in fields:
        which = " " + name_of(FunctionId, fields["function_id"])
    elif settings := fields.get("settings") or [{"parameter_id": p} for p in fields.get("parameter_ids", ())]:
        which = " " + ",".join(parameter_name(setting["parameter_id"]) for setting in settings)
    elif "structure_ids" in fields:
        which = " " + ",".join(name_of(HousekeepingId, number) for number in fields["structure_ids"])
    return f"{message}{which} {definition.label} (APID 0x{apid:X}, count {sequence_count})"


def parameter_name(number: int) -> str:
    """Name of a parameter as unit files write it."""
    return name_of(ParameterId, number).lower()


def plain(value: Any) -> Any:
    """`value` of a decoded field for JSON: octets as hexadecimal text, times as integer TAI nanoseconds."""
    if isinstance(value, (bytes, bytearray)):
        return bytes(value).hex()
    if isinstance(value, CucTime):
        return value.to_ns()
    if isinstance(value, Mapping):
        return {
            (f"{name}_tai_ns" if isinstance(entry, CucTime) else name): plain(entry)
            for name, entry in value.items()
        }
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return value


def field_text(elements: Sequence[Element], name: str, value: Any) -> str:
    """A decoded value for a person: by its name where the field `name` among `elements` is an enumeration."""
    field = next((entry for entry in elements if isinstance(entry, Field) and entry.name == name), None)
    if field is not None and field.choices is not None:
        return name_of(field.choices, value)
    if isinstance(value, CucTime):
        return f"{value.to_ns() / 1e9:.6f}"
    if isinstance(value, float):
        single = field is not None and field.type.size_bytes == 4
        return f"{value:.7g}" if single else f"{value:.12g}"
    return str(plain(value))


def event_text(event_id: int, data: Mapping[str, Any]) -> str:
    """An event for a person: `MODE_CHANGED from_mode=STANDBY to_mode=LOST_IN_SPACE cause=3`."""
    elements = EVENTS[event_id].fields if event_id in EVENTS else ()
    parts = [f"{name}={field_text(elements, name, value)}" for name, value in data.items()]
    return " ".join([name_of(EventId, event_id), *parts])
