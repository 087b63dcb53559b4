"""What a budget is of: a unit with its on-board parameters in force, its processor, and the time it has."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property

from ..device.calibration import cycle_budget, processor_in_force, processor_profile
from ..device.parameters import default_parameters
from ..errors import ConfigurationError
from ..firmware_model.parameter_table import PARAMETERS_BY_NAME
from ..firmware_model.processor import LINE_FILLS, CycleBudget, ProcessorProfile
from ..units.profile import UnitProfile

Parameters = tuple[tuple[str, float | int], ...]


@dataclass(frozen=True)
class Subject:
    """A unit and the on-board parameters that differ from its file's, in the order of their names."""

    profile: UnitProfile
    changed: Parameters = ()

    @cached_property
    def parameters(self) -> dict[str, float | int]:
        """All parameters in force."""
        return default_parameters(self.profile) | dict(self.changed)

    def with_parameters(self, **values: float | int) -> Subject:
        """The same unit with parameters as they are after a trip over the wire.

        Raises ConfigurationError naming the parameter and what is allowed.
        """
        changed = dict(self.changed)
        for name, value in values.items():
            try:
                changed[name] = PARAMETERS_BY_NAME[name].stored(value)
            except ValueError as error:
                raise ConfigurationError(f"{name}: {error}") from error
        return Subject(self.profile, tuple(sorted(changed.items())))

    @property
    def pipelined(self) -> bool:
        return bool(self.parameters["pipelined"])

    @cached_property
    def processor(self) -> ProcessorProfile:
        """The processor at the clock, with the caches and the memory of the parameters."""
        return processor_in_force(processor_profile(self.profile), self.parameters)

    @property
    def period_ns(self) -> int:
        return self.profile.frame_period_ns

    @property
    def exposure_ns(self) -> int:
        return int(self.parameters["exposure_us"]) * 1000

    @property
    def readout_ns(self) -> int:
        return round(self.profile.timing.readout_ms * 1_000_000)

    @cached_property
    def _cycle_budgets(self) -> dict[bool, CycleBudget]:
        return {
            pipelined: cycle_budget(self.profile, self.parameters | {"pipelined": int(pipelined)})
            for pipelined in (False, True)
        }

    def cycle_budget(self, pipelined: bool) -> CycleBudget:
        """What the firmware lets a frame take."""
        return self._cycle_budgets[pipelined]

    def budget_ns(self, pipelined: bool) -> int:
        """Time from a frame's read-out to the moment from which on it is late; 0 where none is left."""
        if pipelined:
            return self.period_ns
        return max(0, self.period_ns - self.exposure_ns - self.readout_ns)

    def frames_dropped(self, processing_ns: float, pipelined: bool) -> int:
        """Frames that a frame of this processing time costs: those whose read-out (pipelined) or exposure
        start (not pipelined) finds the processor busy."""
        busy_ns = processing_ns if pipelined else processing_ns + self.exposure_ns + self.readout_ns
        return max(0, int(-(-busy_ns // self.period_ns)) - 1)

    def identity(self) -> dict[str, object]:
        """What the figures depend on of unit and processor, for reports and kept outcomes."""
        table = self.processor.table
        return {
            "unit": self.profile.name,
            "unit_sha256": _hash(self.profile.model_dump(mode="json")),
            "parameters_changed": dict(self.changed),
            "cycle_costs": table.name,
            "cycle_costs_sha256": _hash(asdict(table)),
            "clock_hz": self.processor.clock_hz,
            "cache_kib": self.processor.cache_kib,
            "line_fill": self.processor.line_fill,
        }


def subject_of(
    profile: UnitProfile,
    *,
    parameters: Mapping[str, float | int] | None = None,
    clock_hz: int | None = None,
    cache_kib: int | None = None,
    line_fill: str | None = None,
) -> Subject:
    """A unit with a scenario's parameters and the processor that the command line asks for.

    Raises ConfigurationError naming the option and what is allowed.
    """
    subject = Subject(profile, tuple(sorted((parameters or {}).items())))
    if clock_hz is not None:
        subject = _optioned(subject, "--clock", clock_hz=clock_hz)
    if cache_kib is not None:
        allowed = processor_profile(profile).table.caches_kib
        if cache_kib not in allowed:
            raise ConfigurationError(
                f"--cache {cache_kib}: the cycle costs {processor_profile(profile).name} are known with "
                f"caches of {', '.join(map(str, allowed))} KiB"
            )
        subject = _optioned(subject, "--cache", cache_kib=cache_kib)
    if line_fill is not None:
        if line_fill not in LINE_FILLS:
            raise ConfigurationError(f"--line-fill {line_fill}: allowed are {', '.join(LINE_FILLS)}")
        subject = _optioned(subject, "--line-fill", line_fill=LINE_FILLS.index(line_fill))
    return subject


def _optioned(subject: Subject, option: str, **values: int) -> Subject:
    try:
        return subject.with_parameters(**values)
    except ConfigurationError as error:
        raise ConfigurationError(f"{option}: {error}") from error


def _hash(contents: object) -> str:
    return hashlib.sha256(json.dumps(contents, sort_keys=True, default=str).encode()).hexdigest()
