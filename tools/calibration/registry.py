"""The steps that have kernels: found in the modules of the folder ``steps``, none of them named here."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType

from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.frame_trace import STEPS
from tools.calibration.steps.step import OwnRecords, Step

__all__ = ["families", "own_records", "steps_by_name", "steps_of"]

_PACKAGE = "tools.calibration.steps"


@cache
def families() -> Mapping[str, ModuleType]:
    """The modules that have ``STEPS``, by their names."""
    found = {}
    for path in sorted((Path(__file__).parent / "steps").glob("*.py")):
        if path.stem.startswith("_") or path.stem == "step":
            continue
        module = importlib.import_module(f"{_PACKAGE}.{path.stem}")
        if hasattr(module, "STEPS"):
            found[path.stem] = module
    return found


def steps_of(modules: Mapping[str, ModuleType], required: Iterable[str]) -> dict[str, Step]:
    """Steps by name. ConfigurationError: two modules have the same, or one that is required is missing."""
    steps: dict[str, Step] = {}
    owner: dict[str, str] = {}
    for family, module in modules.items():
        for step in module.STEPS:
            if step.name in steps:
                raise ConfigurationError(
                    f"step {step.name!r} is in {owner[step.name]}.py and in {family}.py: one is needed"
                )
            steps[step.name], owner[step.name] = step, family
    missing = [name for name in required if name not in steps]
    if missing:
        raise ConfigurationError(
            f"no kernels for: {', '.join(missing)}; there are {', '.join(sorted(steps)) or 'none'} "
            "(tools/calibration/steps)"
        )
    return steps


def steps_by_name() -> dict[str, Step]:
    """Every step there is; each of a frame's has kernels. ConfigurationError: see ``steps_of``."""
    return steps_of(families(), STEPS)


def own_records() -> dict[str, OwnRecords]:
    """For the steps that no frame has: what makes their records, by the family's name."""
    return {name: module.own_records for name, module in families().items() if hasattr(module, "own_records")}
