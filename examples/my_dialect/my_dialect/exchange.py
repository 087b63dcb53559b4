"""The scripted exchange of ``st-emulator demo --dialect my_dialect.definition:DIALECT``."""

from __future__ import annotations

import math

from st_emulator.dialects.dialect import DemoSession

from .messages import BY_NUMBER, Bad, Decoder, Frame, encode
from .settings import MySettings

ARCSEC_PER_RAD = 180 * 3600 / math.pi
# ASSUMED: 20.5 arcsec of stellar aberration, not corrected while the unit's time is not set, and noise
ACCURACY_ARCSEC = 40.0


def exchange(session: DemoSession) -> None:
    """Ask for the status, find the attitude, compare it with the truth."""
    settings = session.profile.dialects.get("my_dialect", {})
    address = MySettings.model_validate(settings).address
    decoder = Decoder()

    def frames_within(ms: float) -> list[Frame]:
        received = [item for _, data in session.run(ms) for item in decoder.receive(data)]
        session.check("bad frames", sum(isinstance(item, Bad) for item in received), "==", 0, "frames")
        return [item for item in received if isinstance(item, Frame)]

    def named(frames: list[Frame], name: str) -> list[dict[str, float]]:
        return [item.values() for item in frames if BY_NUMBER[item.number].name == name]

    started = named(frames_within(session.profile.timing.boot_ms + 50), "started")
    session.check("started", len(started), "==", 1, "messages")
    session.say("get_status")
    session.put(encode("get_status", address, {}))
    answers = named(frames_within(50), "status")
    session.check("answered", len(answers), "==", 1, "messages")
    for status in answers:
        session.say(f"status: mode {status['mode']}, start number {status['boot_count']}")
    session.say("find_attitude")
    session.put(encode("find_attitude", address, {}))
    frames = frames_within(3000)
    session.check("completed", len(named(frames, "done")), "==", 1, "commands")
    valid = [values for values in named(frames, "attitude") if values["valid"]]
    session.check("attitudes", len(valid), ">=", 1, "messages")
    for last in valid[-1:]:
        found = (last["x"], last["y"], last["z"], last["w"])
        error = error_arcsec(found, session.true_quaternion(int(last["time_us"]) * 1000))
        session.say(f"attitude of frame {last['frame']}: {error:.1f} arcsec from the truth")
        session.check("attitude error", error, "<=", ACCURACY_ARCSEC, "arcsec")


def error_arcsec(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """The angle between two attitudes; a quaternion and its negative are the same one."""
    apart = min(math.dist(one, other), math.dist(one, [-value for value in other]))
    return 4 * math.asin(min(1.0, apart / 2)) * ARCSEC_PER_RAD
