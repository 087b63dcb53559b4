"""ST[20] on-board parameter management."""

from __future__ import annotations

from ..enumerations import ParameterId
from ..field_types import UINT16
from ..fields import Case, Field, Repeated, Switched
from ..messages import MessageDefinition, ServiceDefinition
from ..parameters import PARAMETER_TABLE

_PARAMETER = Field("parameter_id", UINT16, meaning="parameter", choices=ParameterId, identifier=True)
_VALUE = Switched(
    "value",
    "parameter_id",
    {int(entry.id): Case(entry.name, (entry.field,), single=True) for entry in PARAMETER_TABLE},
    "value, in the parameter's type",
)

SERVICE = ServiceDefinition(
    20,
    "On-board parameter management",
    "6.20, 8.20",
    "Reading and setting of parameters. A set value is stored and outlives a restart.",
    (
        MessageDefinition(
            "TC",
            20,
            1,
            "parameter_report",
            "Report parameter values",
            "8.20.2.1",
            "Answered by the values of the parameters, in the order asked.",
            (Repeated("parameter_ids", (_PARAMETER,), 1, 64, "parameters"),),
            verification="completion at once",
        ),
        MessageDefinition(
            "TM",
            20,
            2,
            "parameter_values",
            "Parameter value report",
            "8.20.2.2",
            "The present values.",
            (Repeated("values", (_PARAMETER, _VALUE), 1, 64, "parameters and their values"),),
        ),
        MessageDefinition(
            "TC",
            20,
            3,
            "parameter_set",
            "Set parameter values",
            "8.20.2.3",
            "All values are set or, when one of them is refused, none. They are in force from the next "
            "frame start on.",
            (Repeated("settings", (_PARAMETER, _VALUE), 1, 64, "parameters and their new values"),),
            tailoring="All or nothing: one bad setting rejects the request, where the standard (6.20.4.2) "
            "lets the valid settings through.",
            verification="completion at once",
        ),
    ),
)
