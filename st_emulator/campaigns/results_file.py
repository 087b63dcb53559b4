"""Outcomes of a campaign's cases on disk as they come in, so that a stopped run goes on where it was.

JSON lines: a header with what the outcomes depend on, then one line a batch with its CRC-32. A line that was
cut short or damaged counts as not there: its cases run again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np

from ..errors import ConfigurationError

FORMAT = "st-emulator campaign outcomes 1"
_SOURCES = ("*.py", "*.toml", "*.json")


@functools.cache
def program_fingerprint() -> str:
    """Hash of the program's files and of numpy and numba: outcomes of another program are not mixed in."""
    package = Path(__file__).parent.parent
    digest = hashlib.sha256(f"{np.__version__} {numba.__version__}".encode())
    # two of the rooms may be links, which rglob passes by
    rooms = (package, package / "protocol", package / "firmware_model")
    found = {path.resolve() for room in rooms for kind in _SOURCES for path in room.rglob(kind)}
    for contents in sorted(hashlib.sha256(path.read_bytes()).digest() for path in found):
        digest.update(contents)
    return digest.hexdigest()[:16]


def identity_hash(identity: Mapping[str, Any]) -> str:
    """Short name of what a campaign's outcomes depend on."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


class ResultsFile:
    """The outcomes of one campaign: those that were there, and those appended.

    ``named`` by the user: kept at the end, and what is wrong with it is told (ConfigurationError). Else the
    campaign does without it when it cannot be written.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any], *, named: bool, fresh: bool = False) -> None:
        self.path = path
        self.named = named
        self._identity = dict(identity)
        self._kept: dict[int, dict[int, Any]] = {}
        self._whole_end = True  # the file ends with a line's end
        self._has_header = False
        self.usable = True
        if fresh:
            self.remove()
        with self._told("read"):
            if path.exists():
                self._load(path.read_bytes())

    @contextlib.contextmanager
    def _told(self, what: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.usable = False
            if self.named:
                raise ConfigurationError(
                    f"--results {self.path}: cannot be {what}: {error.strerror}"
                ) from error

    def _load(self, data: bytes) -> None:
        if not data:
            return
        lines = data.split(b"\n")
        self._whole_end = lines[-1] == b""
        header = _object(lines[0])
        if header.get("format") != FORMAT:
            self._not_ours(f"is no file of '{FORMAT}'")
            return
        self._has_header = True
        theirs = header.get("identity")
        if theirs != self._identity:
            theirs = theirs if isinstance(theirs, dict) else {}
            differ = [name for name, value in self._identity.items() if theirs.get(name) != value]
            self._not_ours(f"holds another campaign's outcomes: {', '.join(differ) or 'identity'} differ")
            return
        for line in lines[1:]:
            batch = _object(line)
            body = batch.get("batch")
            if body is None or batch.get("crc32") != _crc32(body):
                continue
            stage, indices, outcomes = body
            self._kept.setdefault(stage, {}).update(zip(indices, outcomes, strict=True))

    def _not_ours(self, reason: str) -> None:
        if self.named:
            raise ConfigurationError(f"--results {self.path}: {reason}")
        self.remove()

    def kept(self, stage: int) -> dict[int, Any]:
        """Outcomes (as JSON holds them) of a stage's cases that are there, by their index."""
        return self._kept.get(stage, {})

    def append(self, stage: int, indices: Sequence[int], outcomes: Sequence[Any]) -> None:
        """Add a batch; when this returns it survives the end of the process, however that ends."""
        if not self.usable:
            return
        body = [stage, list(indices), list(outcomes)]
        text = "" if self._whole_end else "\n"
        if not self._has_header:
            text += json.dumps({"format": FORMAT, "identity": self._identity}) + "\n"
        text += json.dumps({"batch": body, "crc32": _crc32(body)}, separators=(",", ":")) + "\n"
        with self._told("written"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab") as file:
                file.write(text.encode())
            self._has_header = self._whole_end = True

    def remove(self) -> None:
        """Delete the file; what it held is forgotten."""
        self._kept.clear()
        self._has_header, self._whole_end = False, True
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)

    def finished(self) -> None:
        """The campaign is through: only a file that the user has named stays."""
        if not self.named:
            self.remove()


def _object(line: bytes) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _crc32(body: Any) -> int:
    return zlib.crc32(json.dumps(body, separators=(",", ":")).encode())
