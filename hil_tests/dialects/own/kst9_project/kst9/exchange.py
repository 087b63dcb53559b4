"""The scripted exchange of ``st-emulator demo --dialect kst9.definition:DIALECT``."""

from __future__ import annotations

from st_emulator.dialects.dialect import DemoSession

from .angles import pointing
from .messages import Decoder, Sentence, encode
from .settings import Kst9Settings

ACCURACY_ARCSEC = 30.0  # ASSUMED: 20.5 of aberration, as the time is not set, and noise


def exchange(session: DemoSession) -> None:
    """Leave the loader, wait for the attitude that comes by itself, compare it with the truth."""
    settings = Kst9Settings.model_validate(session.profile.dialects.get("kst9", {}))
    decoder = Decoder()

    def run(ms: float) -> list[Sentence]:
        received = [item for _, data in session.run(ms) for item in decoder.receive(data)]
        return [item for item in received if isinstance(item, Sentence)]

    run(session.profile.timing.boot_ms + 10)
    session.say("RUN")
    session.put(encode(settings.letter, "RUN"))
    sentences = run(3000)
    session.check("ready", sum(item.kind == "RDY" for item in sentences), "==", 1, "sentences")
    attitudes = [item.fields for item in sentences if item.kind == "ATT" and item.fields[3]]
    session.check("attitudes", len(attitudes), ">=", 1, "sentences")
    _, declination, _ = pointing(session.true_quaternion(session.now_ns))
    for last in attitudes[-1:]:
        off = abs(float(last[4]) - declination) * 3600
        session.say(f"declination {last[4]} deg, {off:.1f} arcsec from the truth")
        session.check("declination", off, "<=", ACCURACY_ARCSEC, "arcsec")
