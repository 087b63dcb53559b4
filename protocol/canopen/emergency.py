"""Emergency messages (CiA 301, 7.2.7): the error register, the history, and what is said of an error."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final

from .sdo import AbortCode

HISTORY_ERRORS: Final = 8
DETAIL_BYTES: Final = 5


class ErrorRegister(IntFlag):
    """Object 1001h (CiA 301, table 25): the bits that the card uses."""

    GENERIC = 0x01
    COMMUNICATION = 0x10
    MANUFACTURER = 0x80


class EmergencyCode(IntEnum):
    """CiA 301, table 26; FFxxh are the device's own."""

    NO_ERROR = 0x0000
    GENERIC = 0x1000
    DEVICE_HARDWARE = 0x5000
    INTERNAL_SOFTWARE = 0x6100
    DATA_SET = 0x6300
    CAN_OVERRUN = 0x8110
    CAN_ERROR_PASSIVE = 0x8120
    RECOVERED_FROM_BUS_OFF = 0x8140
    PDO_LENGTH = 0x8210
    SYNC_LENGTH = 0x8240
    SENSOR_BLINDED = 0xFF01
    PROCESSOR_OVERRUN = 0xFF02


@dataclass(frozen=True)
class EmergencyMeaning:
    """``details``: what the five octets behind the register hold. ``lasting``: the error stays in the
    register until it is over, which a message of code 0000h tells."""

    register: ErrorRegister
    lasting: bool
    meaning: str
    details: str = "0"


_GENERIC, _COMMUNICATION = ErrorRegister.GENERIC, ErrorRegister.COMMUNICATION
_MANUFACTURER = ErrorRegister.MANUFACTURER

EMERGENCIES: Final[Mapping[EmergencyCode, EmergencyMeaning]] = {
    EmergencyCode.GENERIC: EmergencyMeaning(
        _GENERIC, True, "state ERROR by a fault that has no code of its own, or on command", "u8 cause"
    ),
    EmergencyCode.DEVICE_HARDWARE: EmergencyMeaning(
        _GENERIC, True, "state ERROR: the image sensor gives no frame, or the self-test failed", "u8 cause"
    ),
    EmergencyCode.INTERNAL_SOFTWARE: EmergencyMeaning(
        _GENERIC, True, "state ERROR: the program memory is damaged", "u8 cause"
    ),
    EmergencyCode.DATA_SET: EmergencyMeaning(
        _GENERIC,
        True,
        "state ERROR: the star catalogue is damaged; or, without ERROR, the stored parameters are (factory "
        "values are in force)",
        "u8 cause of the fault, or 80h + cause of the store",
    ),
    EmergencyCode.CAN_OVERRUN: EmergencyMeaning(
        _COMMUNICATION,
        False,
        "frames to be sent were lost, for the bus did not take them",
        "u32 frames so far",
    ),
    EmergencyCode.CAN_ERROR_PASSIVE: EmergencyMeaning(
        _COMMUNICATION, True, "the CAN controller is error passive"
    ),
    EmergencyCode.RECOVERED_FROM_BUS_OFF: EmergencyMeaning(
        _COMMUNICATION, False, "the CAN controller was off the bus and is back", "u32 times so far"
    ),
    EmergencyCode.PDO_LENGTH: EmergencyMeaning(
        _COMMUNICATION,
        False,
        "an RPDO was shorter than its objects and was not processed",
        "u8 RPDO, u8 octets",
    ),
    EmergencyCode.SYNC_LENGTH: EmergencyMeaning(
        _COMMUNICATION, False, "a SYNC with (without) counter where 1019h says without (with)", "u8 octets"
    ),
    EmergencyCode.SENSOR_BLINDED: EmergencyMeaning(
        _MANUFACTURER, True, "the image background is above the limit: Sun, Moon or Earth near the field"
    ),
    EmergencyCode.PROCESSOR_OVERRUN: EmergencyMeaning(
        _MANUFACTURER,
        True,
        "a frame was late or dropped, for the processor is short of cycles",
        "u32 frame index",
    ),
}


class Emergencies:
    """Errors that are there and that were there."""

    def __init__(self) -> None:
        self._active: dict[EmergencyCode, ErrorRegister] = {}
        self._history: deque[int] = deque(maxlen=HISTORY_ERRORS)

    def reset(self) -> None:
        """As after a start."""
        self._active.clear()
        self._history.clear()

    @property
    def register(self) -> int:
        """Object 1001h."""
        bits = 0
        for register in self._active.values():
            bits |= register | ErrorRegister.GENERIC
        return bits

    def raise_error(self, code: EmergencyCode, details: bytes = b"") -> bytes | None:
        """An error has come up: its message; None where it is there already."""
        meaning = EMERGENCIES[code]
        if code in self._active:
            return None
        bits = self.register | meaning.register | ErrorRegister.GENERIC
        if meaning.lasting:
            self._active[code] = meaning.register
        filled = details[:DETAIL_BYTES].ljust(DETAIL_BYTES, b"\0")
        self._history.appendleft(code | int.from_bytes(filled[:2], "little") << 16)
        return int(code).to_bytes(2, "little") + bytes((bits,)) + filled

    def clear_error(self, code: EmergencyCode) -> bytes | None:
        """A lasting error is over: code 0000h with what is left in the register; None: it was not there."""
        if self._active.pop(code, None) is None:
            return None
        return bytes((0, 0, self.register)) + bytes(DETAIL_BYTES)

    # -- object 1003h: sub-index 0 says how many, 1 is the newest; each is code and the first two details

    def count(self) -> int:
        """Errors in the history."""
        return len(self._history)

    def past(self, number: int) -> int | AbortCode:
        """The ``number``-th newest."""
        return self._history[number - 1] if number <= len(self._history) else AbortCode.NO_DATA

    def forget(self) -> None:
        """Empty the history."""
        self._history.clear()
