"""On-board parameters: defaults of the unit file, changed by telecommand, kept in the non-volatile memory."""

from __future__ import annotations

from collections.abc import Mapping

from ..firmware_model.causes import StoreInvalidCause
from ..firmware_model.cycle_table import LINE_FILLS
from ..firmware_model.parameter_table import PARAMETERS_BY_NAME
from ..units.profile import UnitProfile
from .calibration import firmware_configuration, processor_in_force, processor_profile
from .commands import Refusal, RefusedError
from .counters import saturated
from .imaging import FrameSettings
from .store import Store, StoreContents

BOOT_COUNT = "boot_count"


def default_parameters(profile: UnitProfile) -> dict[str, float | int]:
    """Factory values by name, from the unit file, as the memory keeps them."""
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
    return {name: PARAMETERS_BY_NAME[name].stored(value) for name, value in values.items()}


class Parameters:
    """The unit's parameters by name; ``boot_count`` is read only.

    ``fault_at_start``: why factory values are in force since the start, or None.
    """

    def __init__(self, profile: UnitProfile, store: Store) -> None:
        self._profile = profile
        self._store = store
        self._defaults = default_parameters(profile)
        self._values = dict(self._defaults)
        self._processor = processor_profile(profile)
        self._settings: FrameSettings | None = None
        self.boot_count = 0
        self.fault_at_start: StoreInvalidCause | None = None

    def load(self, *, count_start: bool) -> None:
        """Read the non-volatile memory, as a start does."""
        contents, fault = self._store.load()
        if fault is None and not all(self.fits(name, value) for name, value in contents.parameters.items()):
            contents, fault = StoreContents(boot_count=contents.boot_count), StoreInvalidCause.OUT_OF_RANGE
        self._values = self._defaults | contents.parameters
        self._settings = None
        self.boot_count = contents.boot_count + int(count_start)
        self.fault_at_start = fault
        if count_start:
            self._save()

    def fits(self, name: str, value: float | int) -> bool:
        """Whether a parameter of this unit can be set to the value."""
        definition = PARAMETERS_BY_NAME.get(name)
        if definition is None or definition.read_only or not definition.fits(value):
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

    def check(self, values: Mapping[str, float | int]) -> None:
        """Refuse names that there are not, read-only ones, and values that do not fit this unit."""
        for name, value in values.items():
            definition = PARAMETERS_BY_NAME.get(name)
            if definition is None:
                raise RefusedError(Refusal.UNKNOWN_ID, name)
            if definition.read_only:
                raise RefusedError(Refusal.READ_ONLY, name)
            if not self.fits(name, value):
                raise RefusedError(Refusal.OUT_OF_RANGE, name)

    def store(self, values: Mapping[str, float | int]) -> int:
        """Set checked values and keep them; in force at the next exposure. Returns how many were set."""
        for name, value in values.items():
            self._values[name] = PARAMETERS_BY_NAME[name].stored(value)
        self._settings = None
        self._save()
        return len(values)

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
