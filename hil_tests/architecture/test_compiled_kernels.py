"""Where compiled kernels are kept."""

import os
import subprocess
import sys
from pathlib import Path

PRINT = "import os, st_emulator; print(os.environ['NUMBA_CACHE_DIR'])"


def cache_folder(**environment: str) -> Path:
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    return Path(
        subprocess.check_output([sys.executable, "-c", PRINT], text=True, env=kept | environment).strip()
    )


def test_in_the_users_cache_folder(tmp_path: Path) -> None:
    folder = cache_folder(XDG_CACHE_HOME=str(tmp_path))
    assert folder.parent == tmp_path / "st-emulator"
    assert folder.name.startswith("kernels-")


def test_in_a_folder_of_the_users_own_where_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    folder = cache_folder(XDG_CACHE_HOME=str(tmp_path / "file"), TMPDIR=str(tmp_path))
    own = tmp_path / f"st-emulator-cache-{os.getuid()}"
    assert folder.parent.parent == own
    assert own.stat().st_mode & 0o777 == 0o700


def test_never_where_others_can_write(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / f"st-emulator-cache-{os.getuid()}").mkdir()
    (tmp_path / f"st-emulator-cache-{os.getuid()}").chmod(0o777)
    folder = cache_folder(XDG_CACHE_HOME=str(tmp_path / "file"), TMPDIR=str(tmp_path))
    assert folder.parent.parent.name.startswith("st-emulator-")
    assert folder.parent.parent.name != f"st-emulator-cache-{os.getuid()}"
