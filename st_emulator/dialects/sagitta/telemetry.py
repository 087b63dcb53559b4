"""The data of each telemetry, from what the device has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ...device.imaging import FrameRecord
from ...device.star_tracker import StarTracker
from ...firmware_model.aberration import apparent_directions, earth_velocity_km_s
from ...firmware_model.attitude import attitude_matrix
from ...firmware_model.frame_result import FrameResult
from ...firmware_model.image.frame import Frame
from ...firmware_model.image.spots import Spots
from ...protocol.sagitta.telemetry import (
    BLOBS,
    CENTROIDS,
    HISTOGRAM_BINS,
    RAILS,
    SECTIONS,
    TELEMETRY,
    TelemetryId,
)
from .solution import Solutions
from .unix_time import unit_time_us

#: ASSUMED: nominal voltages in the order of :data:`RAILS`; no figure of the unit is known.
VOLTAGES: Final = (3.3, 1.2, 1.8, 2.5, 2.1, 3.3, 3.3, 3.3)
Values = dict[str, Any]


class TelemetryData:
    """Makes the data of telemetry.

    Args:
        device: what is told of.
        solutions: what the frames so far gave.
    """

    def __init__(self, device: StarTracker, solutions: Solutions) -> None:
        self._device = device
        self._makers: dict[TelemetryId, Callable[[], Values]] = {
            TelemetryId.TIME: self._time,
            TelemetryId.POWER: self._power,
            TelemetryId.SOLUTION: solutions.values,
            TelemetryId.TEMPERATURE: self._temperature,
            TelemetryId.HISTOGRAM: self._histogram,
            TelemetryId.BLOBS: self._blobs,
            TelemetryId.CENTROIDS: self._centroids,
            TelemetryId.AUTO_BLOB: self._auto_blob,
            TelemetryId.MATCHED: self._matched,
            TelemetryId.BLOB_STATISTICS: self._blob_statistics,
        }
        assert set(self._makers) == set(TelemetryId)

    def of(self, id_: TelemetryId) -> bytes:
        """The data of telemetry ``id_`` now; zeros where there was no frame yet."""
        return TELEMETRY[id_].data.pack(id_.name.lower(), self._makers[id_]())

    def _time(self) -> Values:
        device = self._device
        return {
            "uptime_ms": device.uptime_ms & 0xFFFFFFFF,
            "unix_us": unit_time_us(device.time, device.clock.now_ns),
        }

    def _power(self) -> Values:
        return {f"{rail}_voltage": volt for rail, volt in zip(RAILS, VOLTAGES, strict=True)}

    def _temperature(self) -> Values:
        celsius = self._device.temperature_cdeg / 100
        return {"mcu_degc": celsius, "cmos_degc": celsius, "fpga_degc": celsius}

    def _last(self) -> tuple[FrameRecord, FrameResult] | None:
        record = self._device.last_frame
        return None if record is None or record.result is None else (record, record.result)

    def _histogram(self) -> Values:
        last, image = self._device.last_frame, self._device.image_memory.image
        pixels: Frame | None = None if last is None else last.pixels
        if image is not None and (last is None or image.frame_index > last.index):
            pixels = image.pixels
        return {} if pixels is None else histogram_of(pixels.full(), pixels.bits)

    def _blobs(self) -> Values:
        last = self._last()
        if last is None:
            return {}
        spots = _by_brightness(last[1].spots)
        places = [
            {"x": round(float(x)), "y": round(float(y))}
            for x, y in zip(spots.x_px[:BLOBS], spots.y_px[:BLOBS], strict=True)
        ]
        return {
            "count": min(len(spots) + spots.rejected.total, 0xFFFF),
            "used": min(len(spots), 0xFFFF),
            "four_lines_skipped": int(spots.overflowed),
            "blobs": _filled(places, BLOBS),
        }

    def _centroids(self) -> Values:
        last = self._last()
        if last is None:
            return {}
        spots = _by_brightness(last[1].spots)
        rows = [
            {
                "x": float(spots.x_px[number]),
                "y": float(spots.y_px[number]),
                "magnitude": _octet(10.0 * float(spots.magnitude[number])),
            }
            for number in range(min(len(spots), CENTROIDS))
        ]
        return {"count": min(len(spots), 0xFFFF), "centroids": _filled(rows, CENTROIDS)}

    def _auto_blob(self) -> Values:
        last = self._last()
        return {} if last is None else {"threshold": threshold_dn(*last)}

    def _matched(self) -> Values:
        last = self._last()
        if last is None:
            return {}
        record, result = last
        stars = result.stars
        order = np.argsort(result.spots.magnitude[stars.spot], kind="stable")[:CENTROIDS]
        x_error, y_error = self._errors(record, result)
        rows = [
            {
                "star_id": int(stars.hip[star]),
                "x": float(stars.x_px[star]),
                "y": float(stars.y_px[star]),
                "x_error": float(x_error[star]),
                "y_error": float(y_error[star]),
            }
            for star in order
        ]
        return {"count": min(len(stars), 0xFF), "stars": _filled(rows, CENTROIDS)}

    def _errors(
        self, record: FrameRecord, result: FrameResult
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Measured less expected place of each matched star; 0 where the frame has no valid attitude."""
        nothing = np.zeros(len(result.stars))
        if not result.valid:
            return nothing, nothing
        configuration = record.settings.configuration
        directions = self._device.tables.catalogue.unit_vectors[result.stars.row]
        time = self._device.time
        if configuration.aberration_correction and time.synchronised:
            velocity = earth_velocity_km_s(time.tai_ns(record.mid_exposure_ns))
            directions = apparent_directions(directions, velocity + np.array(configuration.velocity_km_s))
        expected = directions @ attitude_matrix(result.q_icrs_to_sensor).T
        x_px, y_px, _ = configuration.geometry.project(expected)
        return np.nan_to_num(result.stars.x_px - x_px), np.nan_to_num(result.stars.y_px - y_px)

    def _blob_statistics(self) -> Values:
        last = self._last()
        if last is None:
            return {}
        result = last[1]
        matched = set(result.stars.spot.tolist())
        order = np.argsort(-result.spots.flux_dn, kind="stable")[:CENTROIDS]
        noise, threshold = _octet(result.noise_dn), _octet(threshold_dn(*last))
        rows = [
            {
                "noise": noise,
                "threshold": threshold,
                "valid": int(spot in matched),
                "overflow": int(result.spots.saturated[spot]),
            }
            for spot in order.tolist()
        ]
        return {"count": min(len(result.stars), 0xFF), "blobs": _filled(rows, CENTROIDS)}


def threshold_dn(record: FrameRecord, result: FrameResult) -> float:
    """How far over the background a pixel of a spot was in the frame."""
    detection = record.settings.configuration.detection
    factor = detection.sigma_factor if len(result.rects) == 0 else detection.window_sigma_factor
    return float(max(detection.tau_min_dn, factor * result.noise_dn))


def histogram_of(image: npt.NDArray[np.uint16], bits: int) -> Values:
    """Pixels in each bin of the four quarters of an image of so many bits."""
    rows, columns = image.shape
    bins = image.astype(np.uint32) * HISTOGRAM_BINS >> bits
    halves = [
        (slice(0, rows // 2), slice(rows // 2, rows)),
        (slice(0, columns // 2), slice(columns // 2, columns)),
    ]
    quarters = [bins[down, right] for down in halves[0] for right in halves[1]]
    return {
        f"section_{section}": np.bincount(quarter.ravel(), minlength=HISTOGRAM_BINS).tolist()
        for section, quarter in zip(SECTIONS, quarters, strict=True)
    }


def _by_brightness(spots: Spots) -> Spots:
    """Brightest first; in windows they are in the order of the windows."""
    return spots.take(np.argsort(-spots.flux_dn, kind="stable"))


def _filled(rows: list[dict[str, Any]], count: int) -> list[dict[str, Any]]:
    """So many rows, empty ones behind those that there are."""
    return [*rows, *({} for _ in range(count - len(rows)))]


def _octet(value: float) -> int:
    """The nearest whole number that an octet holds."""
    return min(max(round(value), 0), 0xFF)
