"""Types of values on the wire, and what can be wrong with a value."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum
from typing import Any

import construct

from .enumerations import FailureCode
from .packets import CucTime, RequestId


class FieldProblem(Enum):
    """What is wrong with a value."""

    MISSING = "missing"
    UNEXPECTED = "unexpected"
    WRONG_TYPE = "wrong type"
    OUT_OF_RANGE = "out of range"
    UNKNOWN_ID = "unknown identifier"


@dataclass(frozen=True)
class FieldViolation:
    """The first thing wrong with the fields of a message: ``field`` is its path, such as
    ``settings[0].value``.
    """

    field: str
    value: Any
    allowed: str
    problem: FieldProblem

    @property
    def failure_code(self) -> FailureCode:
        """The failure code that a unit answers with."""
        if self.problem is FieldProblem.UNKNOWN_ID:
            return FailureCode.UNKNOWN_ID
        if self.problem is FieldProblem.OUT_OF_RANGE:
            return FailureCode.OUT_OF_RANGE
        return FailureCode.BAD_FIELDS

    def __str__(self) -> str:
        return f"{self.field} = {self.value!r}: {self.problem.value}; allowed: {self.allowed}"


class FieldError(Exception):
    """Carries a violation out of nested elements; the registry turns it into a value or a
    LocalProtocolError.
    """

    def __init__(self, violation: FieldViolation) -> None:
        self.violation = violation
        super().__init__(str(violation))


class _CucAdapter(construct.Adapter):
    def _decode(self, obj: bytes, context: Any, path: str) -> CucTime:
        return CucTime.from_bytes(obj)

    def _encode(self, obj: CucTime, context: Any, path: str) -> bytes:
        return obj.as_bytes()


class _RequestIdAdapter(construct.Adapter):
    def _decode(self, obj: bytes, context: Any, path: str) -> dict[str, int]:
        return RequestId.from_packet(obj).as_fields()

    def _encode(self, obj: RequestId, context: Any, path: str) -> bytes:
        return obj.as_bytes()


@dataclass(frozen=True)
class FieldType:
    """A type on the wire: its name in the interface document, size, construct and, of integers, what fits
    into it.
    """

    name: str
    size_bytes: int
    layout: construct.Construct
    kind: str  # "integer", "float", "time", "request_id"
    lowest: int = 0
    highest: int = 0


def _integer(name: str, size_bytes: int, layout: construct.Construct, signed: bool) -> FieldType:
    bits = 8 * size_bytes
    if signed:
        return FieldType(name, size_bytes, layout, "integer", -(1 << (bits - 1)), (1 << (bits - 1)) - 1)
    return FieldType(name, size_bytes, layout, "integer", 0, (1 << bits) - 1)


UINT8 = _integer("u8", 1, construct.Int8ub, False)
UINT16 = _integer("u16", 2, construct.Int16ub, False)
UINT32 = _integer("u32", 4, construct.Int32ub, False)
INT8 = _integer("i8", 1, construct.Int8sb, True)
INT16 = _integer("i16", 2, construct.Int16sb, True)
INT32 = _integer("i32", 4, construct.Int32sb, True)
FLOAT32 = FieldType("f32", 4, construct.Float32b, "float")
FLOAT64 = FieldType("f64", 8, construct.Float64b, "float")
CUC = FieldType("CUC", 7, _CucAdapter(construct.Bytes(7)), "time")
REQUEST_ID = FieldType("request ID", 4, _RequestIdAdapter(construct.Bytes(4)), "request_id")

_FLOAT32 = struct.Struct(">f")
FLOAT32_MAX = 3.4028234663852886e38


def as_float32(value: float) -> float:
    """``value`` as it comes back from a 32-bit float."""
    return float(_FLOAT32.unpack(_FLOAT32.pack(value))[0])
