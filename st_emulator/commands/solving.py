"""``st-emulator solve``: the firmware, lost in space, on one recorded frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from ..bench.frame_context import undated_context
from ..bench.scenario import Scenario
from ..bench.scenario_inputs import check_inputs
from ..bench.star_tables import star_tables
from ..device.calibration import firmware_configuration, processor_profile
from ..device.parameters import default_parameters
from ..firmware_model.firmware import FirmwareState, process_frame
from ..report import Check, all_hold, check, require_json_path, show_checks, show_figures, write_json
from ..units.profile import load_unit
from ..world import quaternion
from ..world.recorded import RecordedFrames


def solve_image(image: Path, unit: str, json_path: str | None, picture: Path | None, console: Console) -> int:
    """Solve and report; exit status 0 when there is a valid attitude, else 1.

    ``roll_deg`` is the position angle (east of north) of the image's up direction, -Y;
    ``rotation_of_rows_deg`` that of increasing rows, +Y, which is what astrometry.net prints as "up" for
    pictures stored from the top row down. The time of the picture is not known to the firmware, so stellar
    aberration is not corrected (up to 21 arcsec).
    """
    require_json_path(json_path)
    if picture is not None:
        from .pictures import draw_frame, require_picture_path

        require_picture_path(picture)
    profile = load_unit(unit)
    check_inputs(profile, Scenario())
    frame = RecordedFrames([image], profile.detector.columns, profile.detector.rows)[0]
    configuration = firmware_configuration(profile, default_parameters(profile))
    context = undated_context(configuration.exposure_ns, profile.row_time_s)
    result = process_frame(frame, context, FirmwareState.initial(), configuration, star_tables(profile))
    cycles = processor_profile(profile).cycles(result.work)
    figures: dict[str, object] = {"image": str(image), "unit": profile.name, "valid": result.valid}
    checks: list[Check] = [check("valid", int(result.valid), "==", 1, "")]
    if result.valid:
        ra, dec, roll = quaternion.pointing_from_quaternion(result.q_icrs_to_sensor)
        figures |= {
            "ra_deg": ra,
            "dec_deg": dec,
            "roll_deg": roll,
            "rotation_of_rows_deg": (roll % 360.0) - 180.0,
            "q_icrs_to_sensor": [float(value) for value in result.q_icrs_to_sensor],
        }
    else:
        figures |= dict.fromkeys(
            ("ra_deg", "dec_deg", "roll_deg", "rotation_of_rows_deg", "q_icrs_to_sensor"), None
        )
    sigma = np.sqrt(np.diag(result.covariance_rad2)) * 180 / np.pi * 3600
    figures |= {
        "reasons": str(result.reasons.name or "none"),
        "stars": len(result.stars),
        "spots": result.spots_detected,
        "residual_arcsec": result.residual_rms_arcsec,
        "sigma_arcsec": [float(value) for value in sigma] if result.valid else None,
        "cycles": cycles.total,
        "cycles_by_stage": cycles.by_stage,
        "background_dn": result.background_dn,
        "noise_dn": result.noise_dn,
        "identified": [
            {"hip": int(hip), "x_px": float(x), "y_px": float(y), "residual_arcsec": float(residual)}
            for hip, x, y, residual in zip(
                result.stars.hip,
                result.stars.x_px,
                result.stars.y_px,
                result.stars.residual_arcsec,
                strict=True,
            )
        ],
    }
    checks.append(
        check(
            "cycles",
            cycles.total,
            "<=",
            profile.processor.clock_hz * profile.timing.frame_period_ms // 1000,
            "cycles",
        )
    )
    show_figures(console, f"{image.name} by {profile.name}", figures)
    show_checks(console, checks)
    if picture is not None:
        draw_frame(frame, result, picture, title=f"{image.name} by {profile.name}")
    write_json(json_path, figures, checks)
    return 0 if all_hold(checks[:1]) else 1
