"""The non-volatile memory: one small JSON file with a checksum, replaced whole.

A write goes to a new file that is flushed to the disk and then renamed over the old one, so a kill at any
instant leaves either the old or the new contents, never a mixture.
"""

from __future__ import annotations

import contextlib
import json
import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from ..errors import ConfigurationError
from ..firmware_model.causes import StoreInvalidCause

FORMAT = "st-emulator parameters 1"


@dataclass
class StoreContents:
    """What is kept through a restart: parameters by name, and the number of starts."""

    parameters: dict[str, float | int] = field(default_factory=dict)
    boot_count: int = 0


class VolatileStore:
    """A store that lives as long as the emulator: kept through a reset of the unit, not through a
    restart of the program.
    """

    def __init__(self, contents: StoreContents | None = None, fault: StoreInvalidCause | None = None) -> None:
        self._contents = contents or StoreContents()
        self._fault = fault

    def load(self) -> tuple[StoreContents, StoreInvalidCause | None]:
        return StoreContents(dict(self._contents.parameters), self._contents.boot_count), self._fault

    def save(self, contents: StoreContents) -> None:
        self._contents = StoreContents(dict(contents.parameters), contents.boot_count)
        self._fault = None

    def spoil(self, cause: StoreInvalidCause) -> None:
        self._contents, self._fault = StoreContents(), cause


class FileStore:
    """A store in a file.

    Raises:
        ConfigurationError: the folder cannot be made, or the file not be written.
    """

    def __init__(self, path: str | Path, unit_name: str) -> None:
        self.path = Path(path)
        self._unit_name = unit_name
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigurationError(f"{self.path}: cannot make its folder: {error.strerror}") from error

    def load(self) -> tuple[StoreContents, StoreInvalidCause | None]:
        """(contents, why they are factory values or None). A file that was never written is no fault."""
        try:
            data: dict[str, Any] = json.loads(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return StoreContents(), None
        except (OSError, UnicodeDecodeError, json.JSONDecodeError):
            return StoreContents(), StoreInvalidCause.TRUNCATED
        try:
            body = data["contents"]
            if data["format"] != FORMAT or data["crc32"] != _checksum(body):
                return StoreContents(), StoreInvalidCause.BAD_CHECKSUM
            if body["unit"] != self._unit_name:
                return StoreContents(), StoreInvalidCause.OTHER_UNIT
            return StoreContents(dict(body["parameters"]), int(body["boot_count"])), None
        except (KeyError, TypeError, ValueError):
            return StoreContents(), StoreInvalidCause.BAD_CHECKSUM

    def save(self, contents: StoreContents) -> None:
        body = {"unit": self._unit_name, "parameters": contents.parameters, "boot_count": contents.boot_count}
        self._write(body, _checksum(body))

    def spoil(self, cause: StoreInvalidCause) -> None:
        body: dict[str, Any] = {"unit": self._unit_name, "parameters": {}, "boot_count": 0}
        if cause is StoreInvalidCause.TRUNCATED:
            self._replace("")
        else:
            self._write(body, _checksum(body) ^ 1)

    def _write(self, body: dict[str, Any], crc32: int) -> None:
        self._replace(
            json.dumps({"format": FORMAT, "crc32": crc32, "contents": body}, sort_keys=True, indent=1)
        )

    def _replace(self, text: str) -> None:
        temporary = self.path.with_suffix(f".{os.getpid()}.tmp")
        try:
            with temporary.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, self.path)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise ConfigurationError(f"{self.path}: cannot be written: {error.strerror}") from error


def _checksum(body: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(body, sort_keys=True).encode())


class Store(Protocol):
    """A non-volatile memory."""

    def load(self) -> tuple[StoreContents, StoreInvalidCause | None]:
        """(contents, why they are factory values or None)."""

    def save(self, contents: StoreContents) -> None:
        """Keep them in place of what was there."""

    def spoil(self, cause: StoreInvalidCause) -> None:
        """What is kept can be read no more, for this cause (TRUNCATED, BAD_CHECKSUM), until the next save."""
