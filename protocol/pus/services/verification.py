"""ST[01] request verification."""

from __future__ import annotations

from ..enumerations import FailureCode
from ..field_types import REQUEST_ID, UINT8, UINT16, UINT32
from ..fields import Element, Field
from ..messages import MessageDefinition, ServiceDefinition

_REQUEST = Field("request_id", REQUEST_ID, meaning="first 4 bytes of the telecommand packet")
_STEP = Field("step", UINT8, meaning="number of the step, from 1")
_NOTICE = (
    Field("failure_code", UINT16, meaning="failure code", choices=FailureCode),
    Field("failure_data", UINT32, meaning="depends on the failure code"),
)
_NOTICE_TAILORING = "The failure notice's data is one u32 for every failure code."


def _report(
    subservice: int,
    name: str,
    title: str,
    clause: str,
    description: str,
    fields: tuple[Element, ...],
    tailoring: str = "",
) -> MessageDefinition:
    return MessageDefinition("TM", 1, subservice, name, title, clause, description, fields, tailoring)


SERVICE = ServiceDefinition(
    1,
    "Request verification",
    "6.1, 8.1",
    "Says of each telecommand what became of it. Success reports are sent only when the telecommand's "
    "acknowledgement flags ask for them; failure reports are always sent.",
    (
        _report(
            1,
            "acceptance_success",
            "Successful acceptance verification",
            "8.1.2.1",
            "The telecommand is accepted.",
            (_REQUEST,),
        ),
        _report(
            2,
            "acceptance_failure",
            "Failed acceptance verification",
            "8.1.2.2",
            "The telecommand is rejected and changes nothing.",
            (_REQUEST, *_NOTICE),
            _NOTICE_TAILORING,
        ),
        _report(
            3,
            "start_success",
            "Successful start of execution",
            "8.1.2.3",
            "Execution has started.",
            (_REQUEST,),
        ),
        _report(
            4,
            "start_failure",
            "Failed start of execution",
            "8.1.2.4",
            "Execution could not start; nothing is changed.",
            (_REQUEST, *_NOTICE),
            _NOTICE_TAILORING,
        ),
        _report(
            5, "progress", "Successful progress of execution", "8.1.2.5", "A step is done.", (_REQUEST, _STEP)
        ),
        _report(
            6,
            "progress_failure",
            "Failed progress of execution",
            "8.1.2.6",
            "A step failed; execution goes on.",
            (_REQUEST, _STEP, *_NOTICE),
            _NOTICE_TAILORING,
        ),
        _report(
            7,
            "completion_success",
            "Successful completion of execution",
            "8.1.2.7",
            "Execution is complete.",
            (_REQUEST,),
        ),
        _report(
            8,
            "completion_failure",
            "Failed completion of execution",
            "8.1.2.8",
            "Execution ended without success.",
            (_REQUEST, *_NOTICE),
            _NOTICE_TAILORING,
        ),
        _report(
            10,
            "routing_failure",
            "Failed routing verification",
            "8.1.2.10",
            "The APID of the packet belongs to no application process here.",
            (_REQUEST, *_NOTICE),
            _NOTICE_TAILORING,
        ),
    ),
)
