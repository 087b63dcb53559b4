"""``st-emulator export fmu``: a unit as a co-simulation FMU."""

from __future__ import annotations

import json
import re
import sys
import tempfile
from pathlib import Path

from ..bench.scenario import Scenario, load_scenario
from ..bench.scenario_inputs import check_inputs
from ..dialects.registry import require_wire
from ..errors import ConfigurationError
from ..units.profile import UnitProfile, load_unit

SCRIPT = '''"""The unit {unit}, as a co-simulation slave."""

from st_emulator.drivers.fmu import StarTrackerFmu


# The binary of pythonfmu 0.7.0 gives one reference to this module's names back too many, each time it makes
# an instance; without others the names are gone and the master crashes.
KEPT = [globals()]


class {name}(StarTrackerFmu):
    """The unit is in the resources."""

    def __init__(self, **arguments):
        KEPT.append(globals())
        super().__init__(**arguments)
'''


def write_fmu(unit: str, out: Path | None, scenario_path: Path | None) -> Path:
    """Write the FMU of a unit; returns where it lies.

    Raises:
        ConfigurationError: the unit, the scenario or the place is not what it should be, or pythonfmu is
            missing.
    """
    try:
        from pythonfmu import FmuBuilder
    except ImportError as error:
        raise ConfigurationError(
            "export fmu: the package pythonfmu is missing; it comes with pip install 'st-emulator[fmu]'"
        ) from error
    profile = load_unit(unit)
    require_pus_on_serial(profile)
    scenario = Scenario() if scenario_path is None else load_scenario(scenario_path)
    check_inputs(profile, scenario)
    # A unit that nobody commands would do nothing: it acquires by itself.
    scenario = scenario.model_copy(update={"parameters": {"autonomous_start": 1} | scenario.parameters})
    name = "StarTracker_" + re.sub(r"\W", "_", profile.name)
    out = Path(f"{profile.name}.fmu") if out is None else out
    if out.suffix != ".fmu":
        raise ConfigurationError(f"{out}: the name of an FMU ends with .fmu")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="st-emulator-fmu-") as folder:
            resources = {"unit.json": profile, "scenario.json": scenario}
            for file, model in resources.items():
                text = json.dumps(model.model_dump(mode="json", by_alias=True), indent=1, sort_keys=True)
                (Path(folder) / file).write_text(text, encoding="utf-8")
            script = Path(folder) / f"{name}_script.py"
            script.write_text(SCRIPT.format(unit=profile.name, name=name), encoding="utf-8")
            found = list(sys.path)
            try:
                FmuBuilder.build_FMU(
                    script, dest=out, project_files=[Path(folder) / file for file in resources]
                )
            finally:
                sys.path[:] = found
                sys.modules.pop(script.stem, None)
    except OSError as error:
        raise ConfigurationError(f"{out}: cannot be written: {error.strerror or error}") from error
    return out


def require_pus_on_serial(profile: UnitProfile) -> None:
    """Raises ConfigurationError for a unit whose reports the FMU does not read."""
    if profile.wire.dialect != "pus":
        raise ConfigurationError(
            f"export fmu: unit {profile.name} speaks {profile.wire.dialect}; allowed are units that speak pus"
        )
    require_wire(profile, can=False)
