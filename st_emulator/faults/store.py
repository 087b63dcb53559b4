"""The non-volatile memory behind its seam: octets that are written, and octets that lie there."""

from __future__ import annotations

import json
import zlib
from typing import Protocol

from ..device.store import Store, StoreContents
from ..firmware_model.causes import StoreInvalidCause

CHECK_OCTETS = 4


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


class SeamedStore:
    """A store whose octets can be cut off and changed.

    ASSUMED: it has two banks. A write goes into the one that is not in force and counts when it is whole, so
    that power that goes meanwhile leaves what was there before.
    """

    def __init__(self, store: Store, seam: Written) -> None:
        self._store = store
        self._seam = seam
        self._spoilt: StoreInvalidCause | None = None

    def load(self) -> tuple[StoreContents, StoreInvalidCause | None]:
        contents, fault = self._store.load()
        if self._spoilt is not None and fault is None:
            return StoreContents(), self._spoilt
        return contents, fault

    def save(self, contents: StoreContents) -> None:
        image = image_of(contents)
        standing = self._seam.written("parameters", image)
        if len(standing) < len(image):
            return  # the bank before is still the one in force
        if standing == image:
            self._spoilt = None
            self._store.save(contents)
            return
        self._lies_there(standing)

    def _lies_there(self, image: bytes) -> None:
        altered = contents_of(image)
        if altered is None:
            self._spoilt = StoreInvalidCause.BAD_CHECKSUM
        else:
            self._spoilt = None
            self._store.save(altered)
