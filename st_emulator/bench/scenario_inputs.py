"""What a scenario puts into a unit: telecommands at times, parameters in its memory."""

from __future__ import annotations

from dataclasses import dataclass

from ..clock import NS_PER_S
from ..device.calibration import processor_profile
from ..dialects.dialect import ScenarioSender
from ..dialects.registry import dialect_of, settings_of
from ..errors import ConfigurationError
from ..firmware_model.parameter_table import PARAMETERS_BY_NAME
from ..protocol.errors import LocalProtocolError
from ..tai import tai_ns_from_utc
from ..units.profile import UnitProfile
from .scenario import Scenario
from .world_of import camera_model, trajectory_of


@dataclass(frozen=True)
class TimedTelecommand:
    """A telecommand of a scenario at a virtual time: a message of the unit's dialect, or raw octets."""

    at_ns: int
    octets: bytes
    raw: bool

    def send(self, sender: ScenarioSender) -> None:
        """It is due."""
        if self.raw:
            sender.send_raw(self.octets, self.at_ns)
        else:
            sender.send(self.octets, self.at_ns)


def telecommands_of(profile: UnitProfile, scenario: Scenario) -> list[TimedTelecommand]:
    """The telecommands in the order of time, in the unit's dialect.

    Their sequence counts are in that order as well; telecommands of one time stay in the order of the file.

    Raises:
        ConfigurationError: names the scenario, the telecommand, the field and what is allowed.
    """
    definition, settings = dialect_of(profile), settings_of(profile)
    in_order = sorted(enumerate(scenario.telecommands), key=lambda numbered: numbered[1].at_s)
    inputs = []
    count = 0
    for number, item in in_order:
        at_ns = round(item.at_s * NS_PER_S)
        if item.raw_hex is not None:
            inputs.append(TimedTelecommand(at_ns, bytes.fromhex(item.raw_hex), raw=True))
            continue
        assert item.name is not None  # the scenario's own validation sees to it
        try:
            message = definition.encode(profile, settings, item.name, item.fields, count)
        except LocalProtocolError as error:
            raise ConfigurationError(f"{scenario.where}: telecommands.{number}: {error}") from error
        inputs.append(TimedTelecommand(at_ns, message, raw=False))
        count += 1
    return inputs


def parameters_of(scenario: Scenario) -> dict[str, float | int]:
    """The on-board parameters that a scenario sets, as the unit keeps them.

    Raises:
        ConfigurationError: names the scenario, the parameter and what is allowed.
    """
    parameters = {}
    for name, value in scenario.parameters.items():
        definition = PARAMETERS_BY_NAME.get(name)
        if definition is None or definition.read_only:
            allowed = ", ".join(item.name for item in PARAMETERS_BY_NAME.values() if not item.read_only)
            raise ConfigurationError(
                f"{scenario.where}: parameters.{name}: is not a parameter to set; allowed are {allowed}"
            )
        try:
            parameters[name] = definition.stored(value)
        except ValueError as error:
            raise ConfigurationError(f"{scenario.where}: parameters.{error}") from error
    return parameters


def check_inputs(profile: UnitProfile, scenario: Scenario) -> None:
    """Everything that can be wrong with a unit file and a scenario together, before anything is opened.

    Raises:
        ConfigurationError: names the file, the key and what is allowed.
    """
    camera_model(profile)
    processor_profile(profile)
    telecommands_of(profile, scenario)
    parameters_of(scenario)
    try:
        trajectory_of(scenario, tai_ns_from_utc(scenario.start_utc))
    except ValueError as error:
        raise ConfigurationError(f"{scenario.where}: trajectory: {error}") from error
    brightest, faintest = scenario.sky.false_spot_magnitudes
    if brightest > faintest:
        raise ConfigurationError(
            f"{scenario.where}: sky.false_spot_magnitudes: found [{brightest:g}, {faintest:g}]; allowed are "
            f"two magnitudes, the brighter (smaller) one first"
        )
