"""ST[08] function management."""

from __future__ import annotations

from ..enumerations import FunctionId
from ..field_types import UINT8
from ..fields import Case, Field, Switched
from ..functions import FUNCTION_TABLE
from ..messages import MessageDefinition, ServiceDefinition

SERVICE = ServiceDefinition(
    8,
    "Function management",
    "6.8, 8.8",
    "Modes, self-test, reset, image capture and download.",
    (
        MessageDefinition(
            "TC",
            8,
            1,
            "function",
            "Perform a function",
            "8.8.2.1",
            "Performs one of the functions.",
            (
                Field("function_id", UINT8, meaning="function", choices=FunctionId, identifier=True),
                Switched(
                    "arguments",
                    "function_id",
                    {int(function.id): Case(function.name, function.fields) for function in FUNCTION_TABLE},
                    "arguments of the function",
                ),
            ),
            tailoring="The function ID is a number, not a character string; the arguments of a function are "
            "all present, in a fixed order, without their number N and their IDs.",
            verification="by function, see the table of functions",
        ),
    ),
)
