"""The non-volatile memory behind its seam: octets that are written, and octets that lie there."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from typing import Protocol

from ..device.store import Store, StoreContents
from ..firmware_model.causes import StoreInvalidCause

CHECK_OCTETS = 4
STORE_OCTETS = 2048  # ASSUMED: as the memory that service 6 shows; what is not written is zero

Fits = Callable[[str, float | int], bool]


class Written(Protocol):
    """The seam of writing (see :class:`~st_emulator.device.seams.DeviceSeams`)."""

    def written(self, memory: str, octets: bytes) -> bytes: ...


def image_of(contents: StoreContents) -> bytes:
    """What stands in the memory: contents and their check sum.

    ASSUMED: a text, as no layout matters to anybody; its check sum is CRC-32 behind it.
    """
    body = json.dumps([contents.boot_count, contents.parameters], sort_keys=True).encode()
    return body + zlib.crc32(body).to_bytes(CHECK_OCTETS, "big")


def contents_of(image: bytes, *, checked: bool = True) -> StoreContents | None:
    """What an image says; None when its check sum is wrong, or it says nothing."""
    body, check = image[:-CHECK_OCTETS], image[-CHECK_OCTETS:]
    if checked and zlib.crc32(body).to_bytes(CHECK_OCTETS, "big") != check:
        return None
    try:
        boot_count, parameters = json.loads(body)
        return StoreContents(dict(parameters), int(boot_count))
    except (ValueError, TypeError, AttributeError):
        return None


def checked_again(image: bytes) -> bytes:
    """The image with a check sum that agrees with what stands there."""
    body = image[:-CHECK_OCTETS]
    return body + zlib.crc32(body).to_bytes(CHECK_OCTETS, "big")


def with_upset(image: bytes, address: int, bit: int) -> bytes:
    """One bit is another; none of an image's when the address is behind it."""
    if address >= len(image):
        return image
    changed = bytearray(image)
    changed[address] ^= 1 << bit
    return bytes(changed)


def unseen_upsets(image: bytes, address: int, fits: Fits) -> list[int]:
    """The bits of an octet that no check finds when the check sum was computed behind them: what stands there
    then can be read, fits, and says something else.
    """
    before = contents_of(image)
    found = []
    for bit in range(8):
        after = contents_of(checked_again(with_upset(image, address, bit)))
        if after is not None and after != before and _fit(after, fits):
            found.append(bit)
    return found


def _fit(contents: StoreContents, fits: Fits) -> bool:
    return contents.boot_count >= 0 and all(fits(*item) for item in contents.parameters.items())


class SeamedStore:
    """A store whose octets can be cut off and changed.

    ASSUMED: it has two banks. A write goes into the one that is not in force and counts when it is whole, so
    that power that goes meanwhile leaves what was there before.
    """

    def __init__(self, store: Store, seam: Written) -> None:
        self._store = store
        self._seam = seam

    def load(self) -> tuple[StoreContents, StoreInvalidCause | None]:
        return self._store.load()

    def save(self, contents: StoreContents) -> None:
        image = image_of(contents)
        standing = self._seam.written("parameters", image)
        if len(standing) < len(image):
            return  # the bank before is still the one in force
        if standing == image:
            self._store.save(contents)
        else:
            self._stands_there(standing)

    def spoil(self, cause: StoreInvalidCause) -> None:
        self._store.spoil(cause)

    def image(self) -> bytes | None:
        """What lies in the memory; None when it can be read no more."""
        contents, fault = self._store.load()
        return None if fault is not None else image_of(contents)

    def upset(self, address: int, bit: int, *, caught: bool) -> None:
        """One bit of what lies there is another. ``caught``: the check sum does not agree; else it was
        computed behind the upset. Nothing where nothing can be read, or behind it.
        """
        image = self.image()
        if image is None or address >= len(image):
            return
        changed = with_upset(image, address, bit)
        self._stands_there(changed if caught else checked_again(changed))

    def _stands_there(self, image: bytes) -> None:
        body, check = image[:-CHECK_OCTETS], image[-CHECK_OCTETS:]
        altered = contents_of(image)
        if altered is not None:
            self._store.save(altered)
        elif zlib.crc32(body).to_bytes(CHECK_OCTETS, "big") != check:
            self._store.spoil(StoreInvalidCause.BAD_CHECKSUM)
        else:
            self._store.spoil(StoreInvalidCause.TRUNCATED)
