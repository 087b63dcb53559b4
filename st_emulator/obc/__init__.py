"""OBC simulator: what an on-board computer does with a star tracker on the other end of a link.

from st_emulator.obc import Obc

with Obc.connect("pty:/tmp/unit") as obc:
    print(obc.ping())
    obc.acquire()
    obc.wait_for_mode("TRACKING")
    print(obc.next("attitude_report").fields)
"""

from ..links import LinkError
from ..protocol.errors import LocalProtocolError
from ..protocol.pus.enumerations import FailureCode, Mode, Reason
from ..protocol.pus.packets import CucTime, Telemetry
from .attitude import Attitude
from .bus import SyncSent
from .can_transport import CanSettings, CanTransport
from .client import Obc
from .counters import CanCounters, Counters
from .cyclic import CyclicAttitude, CyclicFrame
from .errors import (
    DownloadError,
    NoBusError,
    ObcError,
    RecordingError,
    TelecommandNotDelivered,
    TelecommandTimeout,
    TelemetryTimeout,
    UnitNotChosenError,
    VerificationError,
)
from .exchange import Received
from .image import Image
from .obc_protocol import ObcProtocol
from .observed import Event
from .reading import LiveReader, SteppedReader
from .recorder import RecordedTelemetry, Recorder, read_recording
from .transport import SlipTransport, Transport
from .verification import State, Verification

__all__ = [
    "Attitude",
    "CanCounters",
    "CanSettings",
    "CanTransport",
    "Counters",
    "CucTime",
    "CyclicAttitude",
    "CyclicFrame",
    "DownloadError",
    "Event",
    "FailureCode",
    "Image",
    "LinkError",
    "LiveReader",
    "LocalProtocolError",
    "Mode",
    "NoBusError",
    "Obc",
    "ObcError",
    "ObcProtocol",
    "Reason",
    "Received",
    "RecordedTelemetry",
    "Recorder",
    "RecordingError",
    "SlipTransport",
    "State",
    "SteppedReader",
    "SyncSent",
    "TelecommandNotDelivered",
    "TelecommandTimeout",
    "Telemetry",
    "TelemetryTimeout",
    "Transport",
    "UnitNotChosenError",
    "Verification",
    "VerificationError",
    "read_recording",
]
