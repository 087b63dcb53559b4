"""Faults of the power: cuts at a time or in the middle of something, and a boot loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from ..clock import NS_PER_MS, NS_PER_S, ScheduledEvent
from ..protocol.can.frames import CanFrame
from .fault import AtFrames, AtOctets, AtWriting, Fault, FaultKind, FaultSettings, Reach

WRITES: Final = {"parameter_write": ("parameters",), "memory_load": ("ram", "program")}
IDLE_NS: Final = 50 * NS_PER_MS  # ASSUMED: a pause of a download is shorter, and one between two longer


class CutSettings(FaultSettings):
    kind: Literal["power.cut"]
    during: Annotated[
        Literal["parameter_write", "memory_load", "image_download"] | None,
        Field(
            description="none: power is off from start to end, for good without an end or with duration_s = "
            "0. Else it goes once, in the middle of this, while the fault lasts"
        ),
    ] = None
    at_octet: Annotated[
        int | None,
        Field(
            ge=0,
            description="with during: so many octets were written (a start that counts itself writes the "
            "parameters, too), or have left the unit since the download began; none: 0",
        ),
    ] = None
    off_s: Annotated[
        float | None,
        Field(gt=0, le=10**9, description="with during: power is back after it; none: 1"),
    ] = None

    @model_validator(mode="after")
    def _by_occasion(self) -> CutSettings:
        for key in ("at_octet", "off_s"):
            if getattr(self, key) is not None and self.during is None:
                raise ValueError(f"{key} is for a cut in the middle of something: give during as well")
        return self

    def window_ns(self, now_ns: int) -> tuple[int, int | None]:
        start_ns, end_ns = super().window_ns(now_ns)
        return start_ns, None if self.duration_s == 0 else end_ns


class Cut(AtWriting[CutSettings], AtOctets[CutSettings], AtFrames[CutSettings]):
    def __init__(self, settings: CutSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        language = reach.profile.wire.dialect
        if settings.during == "image_download" and language != "pus":
            raise ValueError(
                f"during: image_download is for the dialect pus, and this unit speaks {language}; allowed "
                "are parameter_write, memory_load"
            )
        self._at_octet = settings.at_octet or 0
        self._fallen = False
        self._left: int | None = None  # octets since the download began; None: there is none
        self._held = False
        self._last_ns = 0
        self._return: ScheduledEvent | None = None
        self._dark = False  # what was on the wire when power went gets no further

    def begin(self) -> None:
        if self.settings.during is None and self.strikes():
            self.reach.supply.cut(self)

    def end(self) -> None:
        if self._return is not None:
            self._return.cancel()
        self.reach.supply.restore(self)

    def _fall(self) -> None:
        self._fallen = True
        self.reach.supply.cut(self)
        off_s = 1.0 if self.settings.off_s is None else self.settings.off_s
        self._return = self.reach.clock.after(round(off_s * NS_PER_S), self._rise)

    def _rise(self) -> None:
        self._dark = False
        self.reach.supply.restore(self)

    # -- while something is written

    def written(self, memory: str, octets: bytes) -> bytes:
        wanted = memory in WRITES.get(self.settings.during or "", ())
        if not wanted or self._fallen or self._at_octet > len(octets) or not self.strikes():
            return octets
        self._fall()
        return octets[: self._at_octet]

    # -- while a download leaves

    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        return octets[: self._leave(len(octets))] if to_obc else octets

    def frame(self, frame: CanFrame, to_obc: bool, forward: Callable[[CanFrame], None]) -> None:
        if not to_obc or self._leave(len(frame.data)) == len(frame.data):
            forward(frame)

    def _leave(self, count: int) -> int:
        """So many of ``count`` octets leave before power goes."""
        if self._dark:
            return 0
        if self.settings.during != "image_download" or self._fallen:
            return count
        now_ns, held = self.reach.clock.now_ns, self.reach.device.image_memory.held
        if held and not self._held:
            self._left = 0 if self.strikes() else None
        elif not held and now_ns - self._last_ns > IDLE_NS:
            self._left = None
        self._held, self._last_ns = held, now_ns
        if self._left is None:
            return count
        missing = self._at_octet - self._left
        self._left += count
        if missing > count:
            return count
        self._fallen = self._dark = True
        self.reach.clock.after(0, self._fall)  # the wire is in the middle of its work
        return max(missing, 0)


class BrownOutSettings(FaultSettings):
    kind: Literal["power.brown_out"]
    after_ms: Annotated[
        float, Field(gt=0, le=10**9, description="from power's return until it falls again")
    ] = 200.0
    off_ms: Annotated[float, Field(gt=0, le=10**9, description="power stays away for it each time")] = 100.0
    times: Annotated[
        int | None, Field(ge=1, le=10**6, description="so often power falls; none: until the end")
    ] = None


class BrownOut(Fault[BrownOutSettings]):
    def __init__(self, settings: BrownOutSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._falls = 0
        self._next: ScheduledEvent | None = None

    def begin(self) -> None:
        self._fall()

    def end(self) -> None:
        if self._next is not None:
            self._next.cancel()
        self.reach.supply.restore(self)

    def _fall(self) -> None:
        if not self.strikes():
            return
        self._falls += 1
        self.reach.supply.cut(self)
        self._next = self._after(self.settings.off_ms, self._rise)

    def _rise(self) -> None:
        if self._falls != self.settings.times:
            self._next = self._after(self.settings.after_ms, self._fall)
        self.reach.supply.restore(self)

    def _after(self, delay_ms: float, action: Callable[[], Any]) -> ScheduledEvent:
        return self.reach.clock.after(max(1, round(delay_ms * NS_PER_MS)), action)


KINDS: Final = (
    FaultKind(
        CutSettings,
        Cut,
        what="Power goes, at a time or in the middle of a parameter write, a memory load or an image "
        "download, and comes back.",
        obc_sees="Silence at once, in the middle of a packet; what waited is lost, and no telecommand gets "
        "a report any more. With power's return and the boot time BOOT_COMPLETED with POWER_ON and "
        "boot_count one more; sequence counts, counters and on-board time begin anew, time status "
        "FREE_RUNNING. Parameters are the old ones or, when the write was whole, the new ones, never "
        "others; RAM is empty and the program as stored; the image is gone.",
        afterwards="The unit is in STANDBY, or tracks again by itself with AUTONOMOUS_START. Whatever the "
        "OBC had set without storing it (time, periodic reports) it sets again.",
    ),
    FaultKind(
        BrownOutSettings,
        BrownOut,
        what="Power falls again and again a while after it came back: a boot loop.",
        obc_sees="With after_ms below the boot time silence; above it BOOT_COMPLETED again and again, with "
        "POWER_ON and a growing boot_count, and nothing that lasts longer than after_ms. Each fall adds to "
        "boot_count, also one in the middle of a boot.",
        afterwards="As after a cut; boot_count tells how often power fell.",
    ),
)
