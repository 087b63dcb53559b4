"""st-emulator: a hardware-in-the-loop star tracker firmware emulator."""

import hashlib
import os
from pathlib import Path

__version__ = "0.1.0"


def _keep_compiled_kernels_apart() -> None:
    """Let numba keep compiled kernels by the contents of our sources.

    Numba compiles a kernel anew when its own file has changed, not when a kernel of another file that it
    calls has: after an update it would run the old code. ``NUMBA_CACHE_DIR`` set by the user stays.
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
    os.environ["NUMBA_CACHE_DIR"] = str(cache / "st-emulator" / f"kernels-{digest.hexdigest()[:16]}")


_keep_compiled_kernels_apart()
