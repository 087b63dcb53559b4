"""A text file that the user asked for: what goes wrong with it is told by its option and path."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from ..errors import ConfigurationError


class OutputFile:
    """A new UTF-8 text file. Opening, writing, closing raise ConfigurationError (a folder, a full disk)."""

    def __init__(self, path: Path, option: str) -> None:
        self._what = f"{option} {path}"
        self._failed = False
        with self._told():
            self._file = path.open("w", encoding="utf-8", newline="\n")

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._failed = True
            raise ConfigurationError(f"{self._what}: cannot be written: {error.strerror}") from error

    def write(self, text: str) -> int:
        with self._told():
            return self._file.write(text)

    def flush(self) -> None:
        with self._told():
            self._file.flush()

    def close(self) -> None:
        """Close; after a failure that was told, whatever could not be written is given up."""
        try:
            if not self._failed and not self._file.closed:
                self.flush()
        finally:
            with contextlib.suppress(OSError):
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
