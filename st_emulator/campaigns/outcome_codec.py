"""Outcomes of cases as JSON and back, exactly: kept outcomes give the same figures as fresh ones.

The type of an outcome is what its function says it returns: numbers, strings, tuples, lists, numpy arrays and
dataclasses of these.
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Callable
from typing import Any

import numpy as np


def outcome_type(function: Callable[..., Any]) -> Any:
    """What a function, or a partial of one, is annotated to return; Any without an annotation."""
    while isinstance(function, functools.partial):
        function = function.func
    return typing.get_type_hints(function).get("return", Any)


def encode(value: Any) -> Any:
    """A value as JSON holds it; floats keep every bit. Raises TypeError for what has no JSON here."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.generic):
        return encode(value.item())
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "values": value.ravel().tolist()}
    if isinstance(value, (list, tuple)):
        return [encode(item) for item in value]
    if dataclasses.is_dataclass(value):
        return [encode(getattr(value, field.name)) for field in dataclasses.fields(value)]
    raise TypeError(f"a campaign's outcome cannot be kept: {type(value).__name__}")


@functools.cache
def _fields(kind: type) -> tuple[Any, ...]:
    hints = typing.get_type_hints(kind)
    return tuple(hints[field.name] for field in dataclasses.fields(kind))


def decode(kind: Any, value: Any) -> Any:
    """The value of type ``kind`` that `encode` made JSON of. ValueError, TypeError: it is other JSON."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if kind is np.ndarray or origin is np.ndarray:
        element = typing.get_args(arguments[1])[0] if len(arguments) > 1 else np.float64
        return np.array(value["values"], dtype=element).reshape(value["shape"])
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        fields = _fields(kind)
        return kind(*(decode(hint, item) for hint, item in zip(fields, value, strict=True)))
    if origin is list:
        return [decode(arguments[0], item) for item in value]
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return tuple(decode(arguments[0], item) for item in value)
        return tuple(decode(hint, item) for hint, item in zip(arguments, value, strict=True))
    return value
