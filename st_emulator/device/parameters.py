"""On-board parameters: defaults of the unit file, changed by telecommand, kept in the non-volatile memory."""

from __future__ import annotations

from ..dialects.pus.reception import RejectedError
from ..firmware_model.cycle_table import LINE_FILLS
from ..protocol.pus.enumerations import FailureCode, ParameterId, StoreInvalidCause
from ..protocol.pus.parameters import PARAMETER_TABLE
from ..units.profile import UnitProfile
from .calibration import firmware_configuration, processor_in_force, processor_profile
from .counters import saturated
from .imaging import FrameSettings
from .store import Store, StoreContents

DEFINITIONS = {int(definition.id): definition for definition in PARAMETER_TABLE}
BY_NAME = {definition.name: definition for definition in PARAMETER_TABLE}
BOOT_COUNT = ParameterId.BOOT_COUNT.name.lower()


def default_parameters(profile: UnitProfile) -> dict[str, float | int]:
    """Factory values by name, from the unit file, as they are after a trip over the wire."""
    values: dict[str, float | int] = {
        "exposure_us": round(profile.timing.exposure_ms * 1000),
        "detection_sigma": profile.detection.sigma,
        "detection_min_pixels": profile.detection.min_pixels,
        "centroid_half_window_px": profile.detection.centroid_half_window_px,
        "magnitude_limit": profile.detection.magnitude_limit,
        "identification_tolerance_arcsec": profile.identification.tolerance_arcsec,
        "identification_max_spots": profile.identification.max_spots,
        "tracking_rate_deg_s": profile.tracking.rate_deg_s,
        "tracking_tolerance_arcsec": profile.tracking.tolerance_arcsec,
        "tracking_min_stars": profile.tracking.min_stars,
        "tracking_max_missed": profile.tracking.max_missed,
        "blinded_background_dn": profile.detection.blinded_background_dn,
        "aberration_correction": 1,
        "velocity_x_km_s": 0.0,
        "velocity_y_km_s": 0.0,
        "velocity_z_km_s": 0.0,
        "attitude_report": int(profile.wire.attitude_report),
        "autonomous_start": 0,
        "pipelined": int(profile.timing.pipelined),
        "clock_hz": profile.processor.clock_hz,
        "cache_kib": profile.processor.cache_kib,
        "line_fill": LINE_FILLS.index(profile.processor.line_fill),
    }
    return {name: BY_NAME[name].as_carried(value) for name, value in values.items()}


class Parameters:
    """The unit's parameters by name; ``boot_count`` is read only."""

    def __init__(self, profile: UnitProfile, store: Store) -> None:
        self._profile = profile
        self._store = store
        self._defaults = default_parameters(profile)
        self._values = dict(self._defaults)
        self._processor = processor_profile(profile)
        self._settings: FrameSettings | None = None
        self.boot_count = 0

    def load(self, *, count_start: bool) -> StoreInvalidCause | None:
        """Read the non-volatile memory; returns why factory values are used instead, or None."""
        contents, fault = self._store.load()
        if fault is None and not all(self._fits(name, value) for name, value in contents.parameters.items()):
            contents, fault = StoreContents(boot_count=contents.boot_count), StoreInvalidCause.OUT_OF_RANGE
        self._values = self._defaults | contents.parameters
        self._settings = None
        self.boot_count = contents.boot_count + int(count_start)
        if count_start:
            self._save()
        return fault

    def _fits(self, name: str, value: float | int) -> bool:
        """Whether a parameter of this unit can be set to the value."""
        definition = BY_NAME.get(name)
        if definition is None or definition.read_only or definition.violation(value) is not None:
            return False
        if name == "cache_kib":
            return value in self._processor.table.caches_kib
        return name != "exposure_us" or value <= self._profile.timing.frame_period_ms * 1000

    def stored_fault(self) -> StoreInvalidCause | None:
        """What is wrong with the non-volatile memory now, or None."""
        return self._store.load()[1]

    def _save(self) -> None:
        self._store.save(StoreContents(self.stored_values(), self.boot_count))

    def stored_values(self) -> dict[str, float | int]:
        """The parameters that differ from the factory values."""
        return {name: value for name, value in self._values.items() if value != self._defaults[name]}

    def __getitem__(self, name: str) -> float | int:
        return saturated(self.boot_count, 16) if name == BOOT_COUNT else self._values[name]

    def by_id(self, parameter_id: int) -> float | int:
        """Value of a parameter of the table."""
        return self[DEFINITIONS[parameter_id].name]

    def check(self, settings: dict[int, float | int]) -> None:
        """Refuse read-only settings and values that do not fit this unit."""
        for parameter_id, value in settings.items():
            definition = DEFINITIONS[parameter_id]
            if definition.read_only:
                raise RejectedError(FailureCode.READ_ONLY, parameter_id)
            if not self._fits(definition.name, value):
                raise RejectedError(FailureCode.OUT_OF_RANGE, parameter_id)

    def store(self, settings: dict[int, float | int]) -> int:
        """Set checked values and keep them; in force at the next exposure. Returns how many were set."""
        for parameter_id, value in settings.items():
            self._values[DEFINITIONS[parameter_id].name] = value
        self._settings = None
        self._save()
        return len(settings)

    def restore_defaults(self) -> int:
        """Factory values; returns how many changed."""
        changed = len(self.stored_values())
        self._values = dict(self._defaults)
        self._settings = None
        self._save()
        return changed

    def frame_settings(self) -> FrameSettings:
        """What a frame needs, for the present values."""
        if self._settings is None:
            self._settings = FrameSettings(
                configuration=firmware_configuration(self._profile, self._values),
                processor=processor_in_force(self._processor, self._values),
                pipelined=bool(self._values["pipelined"]),
                report=bool(self._values["attitude_report"]),
            )
        return self._settings
