"""Where compiled kernels are kept from one process to the next.

The kernels' modules say nothing about it, so that importing them writes nothing: whoever makes what runs
kernels calls :func:`keep_compiled_kernels` first.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

ROOMS_WITH_KERNELS = ("firmware_model", "world")
_one_at_a_time = threading.Lock()
_searched: set[str] = set()  # names of modules; what was imported is not searched again


def keep_compiled_kernels() -> Path:
    """Let numba load the kernels imported so far from the cache folder, and put there what it compiles.

    To be called before the first kernel runs: what is compiled already stays with this process. A further
    call takes microseconds and adds the kernels imported since. Where no numba is loaded there are no
    kernels, and none is loaded for it.

    Returns: the folder; it is there as soon as a kernel was. Every process of the same program and
    environment comes to the same one.

    Raises:
        RuntimeError: numba finds no folder at all that it can write to.
    """
    folder = kernels_folder()
    with _one_at_a_time:
        if sys.modules.keys() <= _searched:
            return folder
        whole = {name for name, module in list(sys.modules.items()) if not _is_being_imported(module)}
        kernels = [kernel for kernel in imported_kernels() if kernel.stats.cache_path is None]
        if kernels:
            config: Any = sys.modules["numba.core.config"]
            # A kernel takes the folder when it is told to cache. Other users of numba keep theirs.
            others = config.CACHE_DIR
            config.CACHE_DIR = str(folder)
            try:
                for kernel in kernels:
                    kernel.enable_caching()
            finally:
                config.CACHE_DIR = others
        _searched.update(whole)
    return folder


def _is_being_imported(module: Any) -> bool:
    """By another thread: its kernels may not be there yet."""
    return getattr(getattr(module, "__spec__", None), "_initializing", False)


def imported_kernels() -> Iterator[Any]:
    """The numba dispatchers in the modules imported so far, each once."""
    dispatchers = sys.modules.get("numba.core.dispatcher")
    if dispatchers is None:
        return
    rooms = tuple(f"st_emulator.{room}." for room in ROOMS_WITH_KERNELS)
    seen = set()
    for name, module in list(sys.modules.items()):
        if not name.startswith(rooms):
            continue
        for value in list(vars(module).values()):
            if isinstance(value, dispatchers.Dispatcher) and id(value) not in seen:
                seen.add(id(value))
                yield value


@cache
def kernels_folder() -> Path:
    """``NUMBA_CACHE_DIR`` if the user set it, else a folder in the user's cache folder that is named after
    the contents of the sources. Where that cannot be written it is in one for temporary files.

    Numba compiles a kernel anew when its own file has changed, not when a kernel of another file that it
    calls has: after an update it would run the old code.
    """
    own = os.environ.get("NUMBA_CACHE_DIR", "")
    if own:
        return Path(own)
    name = f"kernels-{sources_digest(Path(__file__).parent)}"
    root = os.environ.get("XDG_CACHE_HOME", "")
    users = (Path(root) if os.path.isabs(root) else Path.home() / ".cache") / "st-emulator"
    if _can_be_written(users / name):
        return users / name
    return _own_temporary_folder() / "st-emulator" / name


def sources_digest(package: Path) -> str:
    """Hash of all sources in the rooms with kernels of a package's folder."""
    digest = hashlib.sha256()
    for room in ROOMS_WITH_KERNELS:
        for source in sorted((package / room).rglob("*.py")):
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _can_be_written(folder: Path) -> bool:
    """Whether a folder, or the one in which it would have to be made, takes files."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)


def _own_temporary_folder() -> Path:
    """A folder for temporary files that no other user can have put compiled code into.

    Where another took the first name it has one that nobody can know before, and child processes find that.
    """
    temporary = Path(tempfile.gettempdir())
    name = f"st-emulator-cache-{os.getuid()}"
    first = temporary / name
    first.mkdir(mode=0o700, exist_ok=True)
    for folder in (first, *sorted(temporary.glob(f"{name}-*"))):
        if _is_ours_alone(folder):
            return folder
    return Path(tempfile.mkdtemp(prefix=f"{name}-"))


def _is_ours_alone(folder: Path) -> bool:
    if folder.is_symlink() or not folder.is_dir():
        return False
    status = folder.lstat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022
