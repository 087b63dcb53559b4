"""st-emulator: a hardware-in-the-loop star tracker firmware emulator."""

import hashlib
import os
import tempfile
from pathlib import Path

__version__ = "0.1.0"


def _keep_compiled_kernels_apart() -> None:
    """Let numba keep compiled kernels by the contents of our sources.

    Numba compiles a kernel anew when its own file has changed, not when a kernel of another file that it
    calls has: after an update it would run the old code. ``NUMBA_CACHE_DIR`` set by the user stays. Where
    the cache folder cannot be written, numba would refuse to start: the folder for temporary files serves.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    digest = hashlib.sha256()
    package = Path(__file__).parent
    for room in ("firmware_model", "world"):
        for source in sorted((package / room).rglob("*.py")):
            digest.update(source.read_bytes())
    root = os.environ.get("XDG_CACHE_HOME", "")
    cache = Path(root) if os.path.isabs(root) else Path.home() / ".cache"
    if not _can_be_written(cache / "st-emulator"):
        cache = _own_temporary_folder()
    os.environ["NUMBA_CACHE_DIR"] = str(cache / "st-emulator" / f"kernels-{digest.hexdigest()[:16]}")


def _can_be_written(folder: Path) -> bool:
    """Whether a folder, or the one in which it would have to be made, takes files."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)


def _own_temporary_folder() -> Path:
    """A folder for temporary files that no other user can have put compiled code into."""
    folder = Path(tempfile.gettempdir()) / f"st-emulator-cache-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    mine = folder.is_dir() and not folder.is_symlink() and status.st_uid == os.getuid()
    return folder if mine and not status.st_mode & 0o022 else Path(tempfile.mkdtemp(prefix="st-emulator-"))


_keep_compiled_kernels_apart()
