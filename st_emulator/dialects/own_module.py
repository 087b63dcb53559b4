"""Modules of a user's own, which may lie beside the file that names them.

Nothing is put on ``sys.path``, so that no file beside a unit file takes the place of a module of Python or of
an installed package: the one top-level name asked for is looked for there, and what lies in that package.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
import traceback
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

from ..errors import ConfigurationError


def imported(name: str, beside: Path | None, current: Path) -> ModuleType:
    """Import a module by its full name: from the folder ``beside``, else from the Python path, else from the
    folder ``current``.

    Raises:
        ConfigurationError: it is not there, or importing it failed; one line, with the place of the failure.
    """
    top = name.partition(".")[0]
    try:
        if not (_load_from(beside, top) or _on_path(top) or _load_from(current, top)):
            raise ConfigurationError(_nowhere(top, beside, current))
        return importlib.import_module(name)
    except ConfigurationError:
        raise
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(error.name + ".")):
            raise ConfigurationError(_not_in_package(error.name)) from error
        raise ConfigurationError(_failed(name, error)) from error
    except (Exception, SystemExit) as error:  # whatever a user's module does
        raise ConfigurationError(_failed(name, error)) from error


def _on_path(top: str) -> bool:
    return top in sys.modules or importlib.util.find_spec(top) is not None


def _load_from(folder: Path | None, top: str) -> bool:
    """Load a top-level module or package from a folder; False where there is none."""
    spec = None if folder is None else PathFinder.find_spec(top, [str(folder)])
    if spec is None or spec.loader is None:  # a folder without __init__.py hides no package of that name
        return False
    loaded = sys.modules.get(top)
    if loaded is not None:
        if _place(loaded.__spec__) != _place(spec):
            raise ConfigurationError(
                f"module {top} in {folder} cannot be loaded, as another of that name is "
                f"({_place(loaded.__spec__)}); allowed is a name of its own"
            )
        return True
    module = importlib.util.module_from_spec(spec)
    sys.modules[top] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[top]
        raise
    return True


def _place(spec: ModuleSpec | None) -> str:
    """Where a module comes from, for comparison and for people."""
    if spec is None:
        return "the program that runs"
    if spec.has_location and spec.origin is not None:
        return str(Path(spec.origin).resolve())
    folders = [str(Path(folder).resolve()) for folder in spec.submodule_search_locations or ()]
    return ", ".join(folders) or str(spec.origin)


def _nowhere(top: str, beside: Path | None, current: Path) -> str:
    folders = [folder for folder in (beside, current) if folder is not None]
    looked = dict.fromkeys([str(folder) for folder in folders] + ["on the Python path"])
    bare = [str(folder / top) for folder in folders if (folder / top).is_dir()]
    reason = f"{bare[0]} has no __init__.py" if bare else f"looked for in {', '.join(looked)}"
    return f"there is no module {top}: {reason}; PYTHONPATH adds to the Python path"


def _not_in_package(missing: str) -> str:
    package, _, name = missing.rpartition(".")
    folders = list(getattr(sys.modules.get(package), "__path__", ()))
    there = sorted(module.name for module in pkgutil.iter_modules(folders))
    if not folders:
        return f"there is no module {name} in {package}, which is no package; allowed is {package}:NAME"
    allowed = f"allowed are {', '.join(there)}" if there else "there are none"
    return f"there is no module {name} in package {package} ({', '.join(folders)}); {allowed}"


def _failed(name: str, error: BaseException) -> str:
    """One line: what went wrong, and where in the user's own files."""
    where = ""
    if isinstance(error, SyntaxError):
        where, text = f"{error.filename}, line {error.lineno}: ", error.msg
    else:
        frames = [
            frame
            for frame in traceback.extract_tb(error.__traceback__)
            if "importlib" not in frame.filename and frame.filename != __file__
        ]
        own = [frame for frame in frames if Path(frame.filename).parent == Path(frames[0].filename).parent]
        if own:
            where = f"{own[-1].filename}, line {own[-1].lineno}: "
        text = str(error)
    hint = ""
    if isinstance(error, ModuleNotFoundError):
        hint = "; allowed are modules of its package (from .messages import ...) and of PYTHONPATH"
    return f"module {name} cannot be imported: {where}{type(error).__name__}: {text}{hint}"
