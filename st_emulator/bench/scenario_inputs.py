"""What a scenario puts into a unit: telecommands at times, parameters in its memory."""

from __future__ import annotations

from ..clock import NS_PER_S
from ..device.calibration import camera_model, processor_profile, trajectory_of
from ..device.parameters import BY_NAME
from ..errors import ConfigurationError
from ..naming import resolve_fields
from ..protocol.errors import LocalProtocolError
from ..protocol.framing import END, FrameReceived, SlipDecoder, slip_encode
from ..protocol.pus.registry import encode_telecommand
from ..units.profile import UnitProfile
from ..world.time_scales import tai_ns_from_utc
from .scenario import Scenario, ScenarioTelecommand

SCENARIO_SOURCE_ID = 0x5C  # the source of a scenario's own telecommands, apart from any OBC's


def telecommands_of(scenario: Scenario, apid: int) -> list[tuple[int, bytes]]:
    """(virtual time in ns, bytes of the line) of each telecommand, in the order of time.

    Their sequence counts are in that order as well; telecommands of one time stay in the order of the file.

    Raises:
        ConfigurationError: names the scenario, the telecommand, the field and what is allowed.
    """
    in_order = sorted(enumerate(scenario.telecommands), key=lambda numbered: numbered[1].at_s)
    inputs = []
    count = 0
    for number, item in in_order:
        inputs.append((round(item.at_s * NS_PER_S), _bytes_of(scenario, number, item, apid, count)))
        count += item.raw_hex is None
    return inputs


def _bytes_of(
    scenario: Scenario, number: int, telecommand: ScenarioTelecommand, apid: int, count: int
) -> bytes:
    if telecommand.raw_hex is not None:
        return bytes.fromhex(telecommand.raw_hex)
    assert telecommand.name is not None  # the scenario's own validation sees to it
    try:
        fields = resolve_fields(telecommand.name, telecommand.fields)
        packet = encode_telecommand(
            telecommand.name,
            fields,
            apid=apid,
            sequence_count=count & 0x3FFF,
            source_id=SCENARIO_SOURCE_ID,
        )
    except LocalProtocolError as error:
        raise ConfigurationError(f"{scenario.where}: telecommands.{number}: {error}") from error
    return slip_encode(packet)


def packets_of(line: bytes) -> list[bytes]:
    """The packets in bytes of the serial line, for another wire. What is no frame there is none here."""
    decoder = SlipDecoder(len(line) + 1)
    events = decoder.receive(line + bytes([END]), 0)
    return [event.data for event in events if isinstance(event, FrameReceived)]


def parameters_of(scenario: Scenario) -> dict[str, float | int]:
    """The on-board parameters that a scenario sets, as the unit keeps them.

    Raises:
        ConfigurationError: names the scenario, the parameter and what is allowed.
    """
    parameters = {}
    for name, value in scenario.parameters.items():
        definition = BY_NAME.get(name)
        if definition is None or definition.read_only:
            allowed = ", ".join(item.name for item in BY_NAME.values() if not item.read_only)
            raise ConfigurationError(
                f"{scenario.where}: parameters.{name}: is not a parameter to set; allowed are {allowed}"
            )
        try:
            parameters[name] = definition.as_carried(value)
        except LocalProtocolError as error:
            raise ConfigurationError(f"{scenario.where}: parameters.{name}: {error}") from error
    return parameters


def check_inputs(profile: UnitProfile, scenario: Scenario) -> None:
    """Everything that can be wrong with a unit file and a scenario together, before anything is opened.

    Raises:
        ConfigurationError: names the file, the key and what is allowed.
    """
    camera_model(profile)
    processor_profile(profile)
    telecommands_of(scenario, profile.apid)
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
