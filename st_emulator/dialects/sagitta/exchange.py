"""The scripted exchange of the demo: what the OBC says from power-on to attitudes, and what comes."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...clock import NS_PER_MS
from ...firmware_model.attitude import rotation_between
from ...protocol.framing import FrameReceived, SlipDecoder
from ...protocol.sagitta.frames import (
    HASH_BYTES,
    HASH_SEED,
    HEADER_BYTES,
    TELEMETRY_HEADER_BYTES,
    MessageType,
    frame_of,
)
from ...protocol.sagitta.parameters import PARAMETERS_BY_NAME
from ...protocol.sagitta.telemetry import TELEMETRY, TELEMETRY_TABLE, TelemetryId
from ...protocol.sagitta.xxh32 import xxh32
from ..dialect import DemoSession
from .scenario_sender import encode_telecommand
from .settings import SagittaSettings
from .wire_frame import WireFrame

ARCSEC_PER_RAD = math.degrees(1.0) * 3600.0
#: Stellar aberration by the Earth's motion, which is not corrected while the time is not set.
MOST_ABERRATION_ARCSEC = 20.6
OBSERVED_MS = 5000.0
MOST_FRAME_BYTES = 1024


@dataclass(frozen=True)
class Heard:
    """A frame of the unit. ``t_ns``: when the last bit of its group of octets had left."""

    t_ns: int
    type: MessageType
    id: int
    payload: bytes

    @property
    def values(self) -> dict[str, Any]:
        """The data of telemetry."""
        data = self.payload[TELEMETRY_HEADER_BYTES - HEADER_BYTES :]
        return TELEMETRY[self.id].data.unpack(data) or {}


class Obc:
    """Says requests and hears frames.

    Args:
        session: the unit.
        settings: how it speaks.
    """

    def __init__(self, session: DemoSession, settings: SagittaSettings) -> None:
        self._session = session
        self._settings = settings
        self._decoder = SlipDecoder(MOST_FRAME_BYTES)
        self.bad_hashes = 0

    def ask(self, name: str, fields: dict[str, Any] | None = None, ms: float = 60.0) -> list[Heard]:
        """Send a request; what comes in the time after it."""
        self._session.put(frame_of(encode_telecommand(self._settings, name, fields or {})))
        return self.listen(ms)

    def listen(self, ms: float) -> list[Heard]:
        """What comes in a time."""
        heard = []
        for t_ns, octets in self._session.run(ms):
            for event in self._decoder.receive(octets, t_ns):
                if isinstance(event, FrameReceived) and len(event.data) >= HEADER_BYTES + HASH_BYTES:
                    body = event.data[:-HASH_BYTES]
                    (found,) = struct.unpack("<I", event.data[-HASH_BYTES:])
                    self.bad_hashes += found != xxh32(body, HASH_SEED)
                    payload = body[HEADER_BYTES:]
                    heard.append(Heard(event.time_ns, MessageType(body[1]), body[2], payload))
        return heard


def exchange(session: DemoSession) -> None:
    """From power-on over the boot to attitudes, matched stars and a time."""
    profile = session.profile
    settings = SagittaSettings.model_validate(profile.dialects.get("sagitta", {}))
    obc = Obc(session, settings)
    boot_ms = profile.timing.boot_ms + 20.0
    obc.listen(boot_ms)
    _start(session, settings, obc, boot_ms)
    _camera(session, obc)
    _attitudes(session, settings, obc)
    _telemetry(session, obc)
    _time(session, obc)
    session.check("sagitta_bad_hashes", obc.bad_hashes, "==", 0, "frames")


def _of(heard: list[Heard], type_: MessageType, id_: int) -> list[Heard]:
    return [frame for frame in heard if frame.type is type_ and frame.id == id_]


def _status_ok(heard: list[Heard], type_: MessageType, id_: int) -> bool:
    return [frame.payload[0] for frame in _of(heard, type_, id_)] == [0]


def _start(session: DemoSession, settings: SagittaSettings, obc: Obc, boot_ms: float) -> None:
    if settings.boot_loader and not settings.boot_loader_answers:
        session.say("power is on: the boot loader takes the action boot alone; a request is not answered")
        answers = len(obc.ask("request_temperature"))
        session.check("sagitta_boot_loader_answers", answers, "==", 0, "frames")
    session.say("action boot")
    taken = _status_ok(obc.ask("boot"), MessageType.ACTION_REPLY, 1)
    session.check("sagitta_boot_taken", int(taken), "==", 1, "")
    obc.listen(boot_ms)


def _camera(session: DemoSession, obc: Obc) -> None:
    camera = PARAMETERS_BY_NAME["camera"]
    exposure_s = session.profile.timing.exposure_ms / 1000
    session.say(f"parameter {camera.id}: exposure {exposure_s * 1000:g} ms, and read back")
    fields = {"exposure_s": exposure_s}
    taken = _status_ok(obc.ask("set_camera", fields), MessageType.SET_PARAMETER_REPLY, camera.id)
    read = _of(obc.ask("read_camera"), MessageType.PARAMETER, camera.id)
    same = [frame.payload[-camera.arguments.octets :] for frame in read] == [
        camera.arguments.pack("set_camera", fields)
    ]
    session.check("sagitta_parameter_read_back", int(taken and same), "==", 1, "")


def _attitudes(session: DemoSession, settings: SagittaSettings, obc: Obc) -> None:
    session.say(f"subscription: solution and temperature, for {OBSERVED_MS / 1000:g} s")
    heard = obc.ask("set_subscription", ms=OBSERVED_MS)
    solutions = _of(heard, MessageType.ASYNCHRONOUS_TELEMETRY, TelemetryId.SOLUTION)
    temperatures = _of(heard, MessageType.ASYNCHRONOUS_TELEMETRY, TelemetryId.TEMPERATURE)
    valid = [frame for frame in solutions if frame.values["valid"]]
    session.say(
        f"{len(solutions)} solutions, {len(valid)} of them valid, and {len(temperatures)} temperatures came"
    )
    session.check("sagitta_valid_solutions", len(valid), ">=", 1, "frames")
    shift = scatter = math.inf
    if valid:
        last = valid[-1].values
        session.say(
            f"q = ({last['w']:.7f}, {last['x']:.7f}, {last['y']:.7f}, {last['z']:.7f}), scalar first; "
            f"{last['matched']} stars matched, {last['stable_count']} solutions in a row"
        )
        session.say("the time is not set: stellar aberration is still there, a shift of all solutions")
        cross = np.array([_cross_arcsec(session, settings, frame) for frame in valid])
        mean = cross.mean(axis=0)
        shift = float(np.linalg.norm(mean))
        scatter = math.sqrt(float(np.mean(np.square(cross - mean))))
    accuracy = session.profile.requirements.cross_boresight_arcsec or 5.0
    most = MOST_ABERRATION_ARCSEC + accuracy
    session.check("sagitta_cross_boresight_shift", shift, "<=", most, "arcsec")
    session.check("sagitta_cross_boresight_scatter_rms", scatter, "<=", accuracy, "arcsec")


def _cross_arcsec(session: DemoSession, settings: SagittaSettings, frame: Heard) -> npt.NDArray[np.float64]:
    """Error of a solution about the two axes across the boresight, at the frame's mid-exposure."""
    timing = session.profile.timing
    exposure_ns = round(timing.exposure_ms * NS_PER_MS)
    readout_ns = round(timing.readout_ms * NS_PER_MS)
    number = (frame.t_ns - exposure_ns - readout_ns) // session.profile.frame_period_ns
    exposed_ns = (exposure_ns + session.profile.last_row_start_ns) // 2
    mid_ns = number * session.profile.frame_period_ns + exposed_ns
    wanted = WireFrame(settings.boresight).of(session.true_quaternion(mid_ns))
    found = frame.values
    error = rotation_between(np.array(wanted), np.array([found[axis] for axis in "xyzw"]))
    across = error[1:] if settings.boresight == "+x" else error[:2]
    return np.asarray(across * ARCSEC_PER_RAD)


def _telemetry(session: DemoSession, obc: Obc) -> None:
    answered = 0
    for definition in TELEMETRY_TABLE:
        heard = _of(obc.ask(f"request_{definition.name}"), MessageType.TELEMETRY, definition.id)
        answered += len(heard) == 1 and bool(heard[0].values)
        if heard and definition.id is TelemetryId.MATCHED:
            stars = heard[0].values["stars"][: heard[0].values["count"]]
            named = ", ".join(f"HIP {star['star_id']}" for star in stars[:4])
            session.say(f"matched stars, the brightest first: {named}")
    session.say(f"{answered} of {len(TELEMETRY_TABLE)} kinds of telemetry came as asked for")
    session.check("sagitta_telemetry_answered", answered, "==", len(TELEMETRY_TABLE), "kinds")


def _time(session: DemoSession, obc: Obc) -> None:
    session.say("action set time: 2026-01-15T00:00:00Z; in force with the next frame")
    begun_ns = session.now_ns
    heard = obc.ask(
        "set_time", {"utc": "2026-01-15T00:00:00Z"}, ms=2.0 * session.profile.timing.frame_period_ms
    )
    taken = _status_ok(heard, MessageType.ACTION_REPLY, 14)
    session.check("sagitta_set_time_taken", int(taken), "==", 1, "")
    asked_ns = session.now_ns
    times = _of(obc.ask("request_time"), MessageType.TELEMETRY, TelemetryId.TIME)
    off_ms = math.inf
    if times:
        since_ms = (times[0].values["unix_us"] - 1_768_435_200_000_000) / 1000
        off_ms = abs(since_ms - (asked_ns - begun_ns) / NS_PER_MS)
    session.check("sagitta_time_off", off_ms, "<=", 10.0, "ms")
