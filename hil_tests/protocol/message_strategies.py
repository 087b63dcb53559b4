"""Hypothesis strategies for the fields of every message, made from the registry's metadata."""

from __future__ import annotations

from enum import IntFlag
from typing import Any

from hypothesis import strategies as st

from st_emulator.protocol import Case, CucTime, Data, Field, MessageDefinition, Repeated, Switched
from st_emulator.protocol.pus.field_types import as_float32

CUC_TIMES = st.builds(CucTime, st.integers(0, 2**32 - 1), st.integers(0, 2**24 - 1))

REQUEST_IDS = st.fixed_dictionaries(
    {
        "version": st.integers(0, 7),
        "packet_type": st.integers(0, 1),
        "secondary_header": st.integers(0, 1),
        "apid": st.integers(0, 2047),
        "sequence_flags": st.integers(0, 3),
        "sequence_count": st.integers(0, 16383),
    }
)


def field_values(field: Field) -> st.SearchStrategy[Any]:
    """Allowed values of one field, NaN left out because it does not equal itself."""
    if field.type.kind == "time":
        return CUC_TIMES
    if field.type.kind == "request_id":
        return REQUEST_IDS
    if field.type.kind == "float":
        width = 8 * field.type.size_bytes
        low, high = field.minimum, field.maximum
        if width == 32:
            low, high = (None if limit is None else as_float32(limit) for limit in (low, high))
        return st.floats(low, high, width=width, allow_nan=False)
    if field.choices is not None:
        if issubclass(field.choices, IntFlag):
            return st.lists(st.sampled_from(list(field.choices)), unique=True).map(sum)
        return st.sampled_from([int(member) for member in field.choices])
    low, high = field.limits()
    return st.integers(int(low), int(high))


@st.composite
def group_values(draw: st.DrawFn, elements: tuple[Any, ...]) -> dict[str, Any]:
    """Allowed values of a group of elements."""
    switched = {element.on: element for element in elements if isinstance(element, Switched)}
    values: dict[str, Any] = {}
    for element in elements:
        if isinstance(element, Field):
            if element.name in switched:
                values[element.name] = draw(st.sampled_from(sorted(switched[element.name].cases)))
            else:
                values[element.name] = draw(field_values(element))
        elif isinstance(element, Data):
            values[element.name] = draw(st.binary(min_size=element.minimum, max_size=element.maximum))
        elif isinstance(element, Repeated):
            item = field_values(element.items[0]) if element.single else group_values(element.items)
            values[element.name] = draw(
                st.lists(item, min_size=element.minimum, max_size=min(element.maximum, 8))
            )
        else:
            case: Case = element.cases[values[element.on]]
            strategy = field_values(case.fields[0]) if case.single else group_values(case.fields)
            values[element.name] = draw(strategy)
    return values


def message_fields(message: MessageDefinition) -> st.SearchStrategy[dict[str, Any]]:
    """Allowed fields of a message."""
    return group_values(message.fields)


def smallest_fields(message: MessageDefinition) -> dict[str, Any]:
    """One set of allowed fields, always the same: lowest numbers, first choices, shortest lists."""
    return _smallest(message.fields)


def _smallest(elements: tuple[Any, ...]) -> dict[str, Any]:
    switched = {element.on: element for element in elements if isinstance(element, Switched)}
    values: dict[str, Any] = {}
    for element in elements:
        if isinstance(element, Field):
            if element.name in switched:
                values[element.name] = min(switched[element.name].cases)
            else:
                values[element.name] = smallest_value(element)
        elif isinstance(element, Data):
            values[element.name] = bytes(element.minimum)
        elif isinstance(element, Repeated):
            item = smallest_value(element.items[0]) if element.single else _smallest(element.items)
            values[element.name] = [item] * element.minimum
        else:
            case = element.cases[values[element.on]]
            values[element.name] = smallest_value(case.fields[0]) if case.single else _smallest(case.fields)
    return values


def smallest_value(field: Field) -> Any:
    """The lowest allowed value of a field, 0 where it has no limits."""
    if field.type.kind == "time":
        return CucTime(0, 0)
    if field.type.kind == "request_id":
        return dict.fromkeys(
            ("version", "packet_type", "secondary_header", "apid", "sequence_flags", "sequence_count"), 0
        )
    if field.choices is not None:
        return 0 if issubclass(field.choices, IntFlag) else min(int(member) for member in field.choices)
    if field.minimum is None:
        return 0.0 if field.type.kind == "float" else 0
    return field.minimum
