"""OBC simulator: what an on-board computer does with a star tracker on the other end of a link.

from st_emulator.obc import Obc

with Obc.connect("pty:/tmp/unit") as obc:
    print(obc.ping())
    obc.acquire()
    obc.wait_for_mode("TRACKING")
    print(obc.next("attitude_report").fields)
"""

from st_emulator.links import LinkError
from st_emulator.protocol.enumerations import FailureCode, Mode, Reason
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.protocol.packets import CucTime, Telemetry

from .attitude import Attitude
from .client import Obc
from .errors import (
    DownloadError,
    ObcError,
    RecordingError,
    TelecommandTimeout,
    TelemetryTimeout,
    VerificationError,
)
from .exchange import Received
from .image import Image
from .obc_protocol import Counters, ObcProtocol
from .observed import Event
from .reading import LiveReader, SteppedReader
from .recorder import RecordedTelemetry, Recorder, read_recording
from .verification import State, Verification

__all__ = [
    "Attitude",
    "Counters",
    "CucTime",
    "DownloadError",
    "Event",
    "FailureCode",
    "Image",
    "LinkError",
    "LiveReader",
    "LocalProtocolError",
    "Mode",
    "Obc",
    "ObcError",
    "ObcProtocol",
    "Reason",
    "Received",
    "RecordedTelemetry",
    "Recorder",
    "RecordingError",
    "State",
    "SteppedReader",
    "TelecommandTimeout",
    "Telemetry",
    "TelemetryTimeout",
    "Verification",
    "VerificationError",
    "read_recording",
]
