"""On-board parameters of service 20: the firmware's own table with its numbers on the wire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...firmware_model import parameter_table
from ...firmware_model.parameter_table import Storage
from ..errors import LocalProtocolError
from .enumerations import ParameterId
from .field_types import FLOAT32, UINT8, UINT16, UINT32, FieldError, FieldType, FieldViolation
from .fields import Field


@dataclass(frozen=True)
class ParameterDefinition:
    """One parameter of the firmware and its number."""

    id: ParameterId
    firmware: parameter_table.ParameterDefinition

    @property
    def name(self) -> str:
        """Its name, as in unit files."""
        return self.firmware.name

    @property
    def type(self) -> FieldType:
        """Its type on the wire: as it is stored."""
        return _TYPES[self.firmware.storage]

    @property
    def unit(self) -> str:
        return self.firmware.unit

    @property
    def minimum(self) -> float:
        return self.firmware.minimum

    @property
    def maximum(self) -> float:
        return self.firmware.maximum

    @property
    def meaning(self) -> str:
        return self.firmware.meaning

    @property
    def read_only(self) -> bool:
        return self.firmware.read_only

    @property
    def field(self) -> Field:
        """Its value as a field."""
        return Field("value", self.type, self.unit, self.minimum, self.maximum, self.meaning)

    def violation(self, value: Any) -> FieldViolation | None:
        """What is wrong with ``value``, None when the parameter may have it (READ_ONLY is not looked at)."""
        try:
            self.field.prepare(value, self.name, True)
        except FieldError as error:
            return error.violation
        return None

    def as_carried(self, value: Any) -> int | float:
        """``value`` as it is after a trip over the wire (32-bit floats rounded); LocalProtocolError when
        not allowed.
        """
        try:
            plain = self.field.prepare(value, self.name, True)
        except FieldError as error:
            violation = error.violation
            raise LocalProtocolError("parameter", self.name, violation.value, violation.allowed) from None
        carried: int | float = self.type.layout.parse(self.type.layout.build(plain))
        return carried


_TYPES = {Storage.U8: UINT8, Storage.U16: UINT16, Storage.U32: UINT32, Storage.F32: FLOAT32}

PARAMETER_TABLE: tuple[ParameterDefinition, ...] = tuple(
    ParameterDefinition(number, parameter_table.PARAMETERS_BY_NAME[number.name.lower()])
    for number in ParameterId
)

PARAMETERS: dict[int, ParameterDefinition] = {int(parameter.id): parameter for parameter in PARAMETER_TABLE}
"""By number."""

PARAMETERS_BY_NAME: dict[str, ParameterDefinition] = {
    parameter.name: parameter for parameter in PARAMETER_TABLE
}
"""By name."""
