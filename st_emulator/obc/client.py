"""The OBC simulator: the unit's services as calls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..clock import NS_PER_S
from ..naming import member, name_of, parameter_name
from ..protocol.pus.enumerations import (
    EventId,
    FunctionId,
    HousekeepingId,
    MemoryId,
    Mode,
    ParameterId,
    ResetKind,
)
from ..protocol.pus.packets import CucTime, Telemetry, crc16_ccitt
from ..protocol.pus.parameters import PARAMETER_TABLE
from ..protocol.pus.services.memory import MAX_DUMP_BYTES, MAX_LOAD_BYTES
from ..tai import tai_ns_from_utc
from .bus import BusExchange
from .errors import DownloadError, TelecommandTimeout, TelemetryTimeout, VerificationError
from .exchange import DEFAULT_TIMEOUT_S
from .image import Image, ImageAssembler
from .observed import Event
from .verification import State, Verification

DOWNLOAD_ROUNDS = 5
_SET_TIME_BYTES = 20
Progress = Callable[[int, int | None], None]


class Obc(BusExchange):
    """An on-board computer that talks to one star tracker.

    Every call waits for its verification and raises VerificationError when the unit reports a failure and
    TelecommandTimeout, naming what never came, when it does not answer. See `Exchange` for telecommands and
    telemetry by name, `BusExchange` for what a CAN bus has beside them.
    """

    _transaction_id = 0

    def ping(self, timeout_s: float = 1.0, *, ack: int | None = None) -> float:
        """TC[17,1] to TM[17,2]: seconds from the sending to the answer's reception."""
        received, verification = self.request("ping", "pong", timeout_s=timeout_s, ack=ack)
        return (received.time_ns - verification.sent_ns) / NS_PER_S

    # Functions and modes

    def function(
        self, name: str | int, /, *, timeout_s: float = DEFAULT_TIMEOUT_S, **arguments: Any
    ) -> Verification:
        """Perform a function: `obc.function("RESET", kind="COLD")`."""
        number = member(FunctionId, name) if isinstance(name, str) else int(name)
        return self.send("function", timeout_s=timeout_s, function_id=number, **arguments)

    def acquire(self, timeout_s: float = 10.0) -> Verification:
        """Go to LOST_IN_SPACE; complete with the first valid attitude."""
        return self.function(FunctionId.START_ACQUISITION, timeout_s=timeout_s)

    def standby(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> Verification:
        """Go to STANDBY."""
        return self.function(FunctionId.GO_STANDBY, timeout_s=timeout_s)

    def self_test(self, timeout_s: float = 10.0) -> Verification:
        """Test the unit; complete when all parts passed."""
        return self.function(FunctionId.START_SELF_TEST, timeout_s=timeout_s)

    def reset(self, kind: str | ResetKind = ResetKind.WARM, timeout_s: float = 10.0) -> Event:
        """Restart the unit and wait until it says BOOT_COMPLETED."""
        mark = self.mark()
        number = member(ResetKind, kind) if isinstance(kind, str) else int(kind)
        self.function(FunctionId.RESET, timeout_s=timeout_s, kind=number)
        return self.wait_for_event("BOOT_COMPLETED", timeout_s, since=mark)

    def shutdown(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> Verification:
        """Store the parameters and go to OFF."""
        return self.function(FunctionId.SHUTDOWN, timeout_s=timeout_s)

    def mode(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> Mode:
        """The present mode, asked for (housekeeping structure STATUS)."""
        return Mode(self.housekeeping("STATUS", timeout_s)["mode"])

    def wait_for_mode(self, mode: str | Mode, timeout_s: float = DEFAULT_TIMEOUT_S) -> float:
        """Wait until the unit is in `mode`; seconds it took. TelemetryTimeout names the mode it is in
        instead.

        Attitude reports, MODE_CHANGED events and housekeeping structure STATUS tell the mode; where none of
        them has come yet, STATUS is asked for.
        """
        wanted = member(Mode, mode) if isinstance(mode, str) else int(mode)
        begun_ns = self.now_ns()
        if self.unit.mode is None:
            self.mode(timeout_s)
        deadline_ns = begun_ns + round(timeout_s * NS_PER_S)
        if not self._reader.wait(lambda: self.unit.mode == wanted, deadline_ns):
            last = "unknown" if self.unit.mode is None else self.unit.mode.name
            raise TelemetryTimeout(f"mode {name_of(Mode, wanted)}", timeout_s, f"the mode is {last}")
        return (self.now_ns() - begun_ns) / NS_PER_S

    # Time

    def set_time(
        self, now: datetime | CucTime | int | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> Verification:
        """Set the on-board time; complete when the unit has taken it over at a frame start.

        now: the time at which the unit receives the telecommand's last byte: an aware datetime, a CucTime
        or TAI nanoseconds since 1958-01-01. None: the computer's time, moved on by the time that the
        telecommand takes on the line or the idle bus.
        """
        if now is None:
            now = tai_ns_from_utc(self._reader.utc_now()) + self.transport.transfer_ns(_SET_TIME_BYTES)
        elif isinstance(now, datetime):
            now = tai_ns_from_utc(now)
        time = now if isinstance(now, CucTime) else CucTime.from_ns(now)
        return self.send("set_time", timeout_s=timeout_s, time=time)

    # Parameters

    def parameters(
        self, names: Iterable[str | int] | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> dict[str, int | float]:
        """Values of parameters by name; None: of all."""
        numbers = (
            [int(entry.id) for entry in PARAMETER_TABLE] if names is None else _numbers(ParameterId, names)
        )
        received, _ = self.request(
            "parameter_report",
            "parameter_values",
            lambda telemetry: [entry["parameter_id"] for entry in telemetry.fields["values"]] == numbers,
            timeout_s=timeout_s,
            parameter_ids=numbers,
        )
        return {
            parameter_name(entry["parameter_id"]): entry["value"]
            for entry in received.telemetry.fields["values"]
        }

    def set_parameters(
        self, values: Mapping[str | int, Any], timeout_s: float = DEFAULT_TIMEOUT_S, *, strict: bool = True
    ) -> Verification:
        """Set parameters by name, all or none. strict: False leaves the check of their ranges to the unit."""
        numbers = _numbers(ParameterId, values)
        settings = [
            {"parameter_id": number, "value": value}
            for number, value in zip(numbers, values.values(), strict=True)
        ]
        return self.send("parameter_set", timeout_s=timeout_s, strict=strict, settings=settings)

    def set_parameter(
        self, name: str | int, value: Any, timeout_s: float = DEFAULT_TIMEOUT_S, *, strict: bool = True
    ) -> Verification:
        """Set one parameter by name."""
        return self.set_parameters({name: value}, timeout_s, strict=strict)

    # Housekeeping and events

    def housekeeping(self, structure: str | int, timeout_s: float = DEFAULT_TIMEOUT_S) -> dict[str, Any]:
        """Values of a housekeeping structure, asked for once."""
        (number,) = _numbers(HousekeepingId, [structure])
        received, _ = self.request(
            "hk_one_shot",
            "hk_report",
            lambda telemetry: telemetry.fields["structure_id"] == number,
            timeout_s=timeout_s,
            structure_ids=[number],
        )
        values: dict[str, Any] = received.telemetry.fields["values"]
        return values

    def enable_housekeeping(
        self, structure: str | int, interval_s: float | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> Verification:
        """Let a structure be reported periodically; interval_s: None leaves the interval as it is."""
        numbers = _numbers(HousekeepingId, [structure])
        if interval_s is not None:
            setting = {"structure_id": numbers[0], "interval_ms": round(interval_s * 1000)}
            self.send("hk_set_interval", timeout_s=timeout_s, intervals=[setting])
        return self.send("hk_enable", timeout_s=timeout_s, structure_ids=numbers)

    def disable_housekeeping(
        self, structure: str | int, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> Verification:
        """Let a structure be reported no more."""
        numbers = _numbers(HousekeepingId, [structure])
        return self.send("hk_disable", timeout_s=timeout_s, structure_ids=numbers)

    def enable_events(self, *names: str | int, timeout_s: float = DEFAULT_TIMEOUT_S) -> Verification:
        """Let events be reported."""
        return self.send("event_enable", timeout_s=timeout_s, event_ids=_numbers(EventId, names))

    def disable_events(self, *names: str | int, timeout_s: float = DEFAULT_TIMEOUT_S) -> Verification:
        """Let events be reported no more."""
        return self.send("event_disable", timeout_s=timeout_s, event_ids=_numbers(EventId, names))

    def disabled_events(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> list[str]:
        """Names of the events that are not reported."""
        received, _ = self.request("event_report_disabled", "event_disabled_list", timeout_s=timeout_s)
        return [name_of(EventId, number) for number in received.telemetry.fields["event_ids"]]

    # Memory

    def memory_load(
        self, memory: str | int, address: int, data: bytes, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> list[Verification]:
        """Write `data` into a memory from `address` on, in as many telecommands as it takes."""
        (number,) = _numbers(MemoryId, [memory])
        verifications = []
        for offset in range(0, len(data), MAX_LOAD_BYTES):
            block = data[offset : offset + MAX_LOAD_BYTES]
            verifications.append(
                self.send(
                    "memory_load",
                    timeout_s=timeout_s,
                    memory_id=number,
                    start_address=address + offset,
                    data=block,
                    checksum=crc16_ccitt(block),
                )
            )
        return verifications

    def memory_dump(
        self, memory: str | int, address: int, length: int, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> bytes:
        """`length` bytes of a memory from `address` on. DownloadError when a checksum does not match."""
        (number,) = _numbers(MemoryId, [memory])
        contents = bytearray()
        while len(contents) < length:
            start, size = address + len(contents), min(MAX_DUMP_BYTES, length - len(contents))
            received, _ = self.request(
                "memory_dump",
                "memory_dump_report",
                _area(number, start),
                timeout_s=timeout_s,
                memory_id=number,
                start_address=start,
                length=size,
            )
            fields = received.telemetry.fields
            if len(fields["data"]) != size or crc16_ccitt(fields["data"]) != fields["checksum"]:
                raise DownloadError(
                    f"memory {name_of(MemoryId, number)} at {start}: {len(fields['data'])} of {size} bytes, "
                    f"checksum 0x{crc16_ccitt(fields['data']):04X}, reported 0x{fields['checksum']:04X}"
                )
            contents += fields["data"]
        return bytes(contents)

    def memory_check(
        self, memory: str | int, address: int, length: int, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> int:
        """CRC-16 of an area of a memory, computed on board."""
        (number,) = _numbers(MemoryId, [memory])
        received, _ = self.request(
            "memory_check",
            "memory_check_report",
            _area(number, address),
            timeout_s=timeout_s,
            memory_id=number,
            start_address=address,
            length=length,
        )
        return int(received.telemetry.fields["checksum"])

    # Images

    def capture_image(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> Verification:
        """Keep the next frame for download; complete when it is there."""
        return self.function(FunctionId.CAPTURE_IMAGE, timeout_s=timeout_s)

    def download_image(
        self, timeout_s: float = DEFAULT_TIMEOUT_S, *, progress: Progress | None = None
    ) -> NDArray[np.uint16]:
        """Pixels of the captured image, uint16[height, width] DN. See `fetch_image`."""
        return self.fetch_image(timeout_s, progress=progress).pixels

    def fetch_image(self, timeout_s: float = DEFAULT_TIMEOUT_S, *, progress: Progress | None = None) -> Image:
        """The captured image with its header: sent in parts, lost parts asked for again, checksum verified.

        timeout_s: longest silence between two parts. progress: called with bytes received and expected
        (None before they are known). DownloadError when parts stay missing or the checksum does not match.
        """
        self._transaction_id = (self._transaction_id + 1) % 0x10000
        assembler = ImageAssembler(self._transaction_id)
        ranges = [(0, 0)]
        for _ in range(DOWNLOAD_ROUNDS):
            for first, count in ranges:
                self._download_parts(assembler, first, count, timeout_s, progress)
            ranges = assembler.missing_ranges()
            if not ranges:
                break
        return assembler.image()

    def _download_parts(
        self, assembler: ImageAssembler, first: int, count: int, timeout_s: float, progress: Progress | None
    ) -> None:
        """Ask for parts and take them, until the unit is done or silent."""
        mark = self.mark()
        verification = self.begin(
            "function",
            timeout_s=timeout_s,
            function_id=FunctionId.DOWNLOAD_IMAGE,
            transaction_id=assembler.transaction_id,
            first_part=first,
            parts=count,
        )

        def take() -> bool:
            nonlocal mark
            for entry in self._since(mark):
                mark = entry.number + 1
                if assembler.take(entry.telemetry):
                    # A part is a sign of life: the unit has not forgotten us.
                    verification.deadline_ns = entry.time_ns + round(timeout_s * NS_PER_S)
                    if progress is not None:
                        progress(assembler.received_bytes, assembler.expected_bytes)
            return verification.finished

        while not self._reader.wait(take, verification.deadline_ns):
            self._expire()
        try:
            self.finish(verification)
        except TelecommandTimeout:
            # A lost report does not spoil the parts that came; without any the unit is simply not there.
            if not assembler.received_parts:
                raise
        if verification.state is State.FAILED:
            raise VerificationError(verification)


def _numbers(choices: Any, names: Iterable[str | int]) -> list[int]:
    return [member(choices, name) if isinstance(name, str) else int(name) for name in names]


def _area(memory_id: int, start_address: int) -> Callable[[Telemetry], bool]:
    """Whether a report is about the memory area that was asked for."""

    def about(telemetry: Telemetry) -> bool:
        fields = telemetry.fields
        return bool(fields["memory_id"] == memory_id and fields["start_address"] == start_address)

    return about
