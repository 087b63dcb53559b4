"""The token of the control socket: in a file that only its user can read, never on a command line."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from ..errors import ConfigurationError

SHORTEST = 16
LONGEST = 512


def token_of(path: Path, option: str) -> str:
    """The token that the file holds; a file that is not there is made, with a new token.

    Raises:
        ConfigurationError: names the option, the file and what is allowed: others can read it, it is no file,
            it holds no token.
    """
    try:
        return _made(path)
    except FileExistsError:
        pass
    except OSError as error:
        raise ConfigurationError(f"{option} {path}: cannot be written: {error.strerror}") from error
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise ConfigurationError(f"{option} {path}: is no file; allowed is a file with a token")
            if status.st_mode & 0o077:
                raise ConfigurationError(
                    f"{option} {path}: others may read or write it (mode {status.st_mode & 0o777:o}); "
                    "allowed is a file of its user alone (chmod 600)"
                )
            text = file.read(LONGEST + 2).decode("ascii").strip()
    except OSError as error:
        raise ConfigurationError(f"{option} {path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{option} {path}: holds no text; {_allowed()}") from error
    if not SHORTEST <= len(text) <= LONGEST or not text.isprintable() or " " in text:
        raise ConfigurationError(f"{option} {path}: holds no token; {_allowed()}")
    return text


def _allowed() -> str:
    return f"allowed is one line of {SHORTEST} to {LONGEST} printable characters without spaces"


def _made(path: Path) -> str:
    token = secrets.token_urlsafe(32)
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        os.fchmod(file.fileno(), 0o600)  # whatever the umask
        file.write(token + "\n")
    return token
