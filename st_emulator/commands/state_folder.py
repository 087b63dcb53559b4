"""Where units and campaigns keep what is theirs."""

from __future__ import annotations

import os
from pathlib import Path


def state_folder() -> Path:
    """``$XDG_STATE_HOME/st-emulator``, else ``~/.local/state/st-emulator``."""
    root = os.environ.get("XDG_STATE_HOME", "")
    return (Path(root) if root and Path(root).is_absolute() else Path.home() / ".local/state") / "st-emulator"
