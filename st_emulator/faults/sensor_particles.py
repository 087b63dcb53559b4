"""Faults of the sensor: protons that cross the detector."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from ..clock import NS_PER_S
from ..firmware_model.image.frame import Frame
from ..world import sensor_faults
from ..world.lit_scene import Scene
from .fault import Exposure, FaultKind, FaultSettings
from .sensor_frame import F64, Converter, LitFrame, SensorFault

# A proton of 100 MeV in silicon: 5.83 MeV cm2/g (NIST PSTAR) x 2.33 g/cm3, 3.65 eV a pair: 372 pairs a um.
# ASSUMED: that energy; it is the middle of what comes through some millimetres of shielding.
ELECTRONS_PER_UM = 372.0
# Width parameter of Landau's distribution over its mean, of the same proton (beta^2 = 0.183): 153.5 keV cm2/g
# x Z/A = 0.498 x 2.33 g/cm3 / beta^2, 97 eV a um, 27 pairs of 372.
LANDAU_WIDTH = 27.0 / ELECTRONS_PER_UM
MOYAL_MEAN = 0.5772156649015329 + math.log(2.0)
# ASSUMED: charge from where there is a field stays in the pixel below it, the rest spreads a little.
DIFFUSION_SIGMA_PX = 0.35
STEP_PX = 0.7  # twice that sigma: the streak is even within 1 %


class ProtonStreaksSettings(FaultSettings):
    kind: Literal["sensor.proton_streaks"]
    rate_per_cm2_s: Annotated[float, Field(gt=0, le=10_000, description="protons through the detector")] = (
        1000.0
    )
    # ASSUMED: the epitaxial layer of an image sensor
    depth_um: Annotated[float, Field(gt=0, le=500, description="of the layer that collects charge")] = 12.0
    electrons_per_um: Annotated[
        float, Field(gt=0, le=1e5, description="mean charge along a track; 372 is a proton of 100 MeV")
    ] = ELECTRONS_PER_UM


class ProtonStreaks(SensorFault[ProtonStreaksSettings]):
    """Tracks of protons that come from everywhere.

    Number: Poisson, of rate, area and exposure. Directions: an isotropic flux through a plane, so that sin^2
    of the angle from the normal is uniform. A track's length in the image is depth x tan, its chord depth /
    cos. Charge: chord x electrons_per_um, with the fluctuation of Landau's law in Moyal's form. ASSUMED: all
    charge is collected, and none while the frame is read out.
    """

    def tracks(self, exposure: Exposure) -> F64:
        """float64[n, 5]: where they enter (x_px, y_px) and leave, electrons."""
        settings, detector = self.settings, self.profile.detector
        chance = self.generator(exposure.index)
        area_cm2 = detector.columns * detector.rows * (detector.pixel_um * 1e-4) ** 2
        mean = settings.rate_per_cm2_s * area_cm2 * exposure.duration_ns / NS_PER_S
        n = int(chance.poisson(mean))
        x = chance.uniform(-0.5, self.width_px - 0.5, n)
        y = chance.uniform(-0.5, self.height_px - 0.5, n)
        azimuth = chance.uniform(0.0, 2.0 * math.pi, n)
        cosine = np.sqrt(1.0 - chance.uniform(0.0, 1.0, n))
        # one that runs along the layer ends where the detector does
        longest_um = math.hypot(self.width_px, self.height_px) * detector.pixel_um
        steepest = settings.depth_um / math.hypot(settings.depth_um, longest_um)
        cosine = np.maximum(cosine, steepest)
        chord_um = settings.depth_um / cosine
        length_px = settings.depth_um * np.sqrt(1.0 - cosine**2) / cosine / detector.pixel_um
        moyal = -np.log(chance.standard_normal(n) ** 2)
        fluctuation = 1.0 + LANDAU_WIDTH * (moyal - MOYAL_MEAN)
        electrons = settings.electrons_per_um * chord_um * np.maximum(fluctuation, 0.0)
        ends = (x + length_px * np.cos(azimuth), y + length_px * np.sin(azimuth))
        return np.stack((x, y, *ends, electrons), axis=1)

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        def light() -> Scene:
            x0, y0, x1, y1, electrons = self.tracks(exposure).T
            pieces = np.maximum(np.ceil(np.hypot(x1 - x0, y1 - y0) / STEP_PX), 1).astype(np.int64)
            of = np.repeat(np.arange(len(pieces)), pieces)
            number = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
            along = (number + 0.5) / pieces[of]
            return sensor_faults.light(
                self.width_px,
                self.height_px,
                DIFFUSION_SIGMA_PX,
                xs=(x0[of] + along * (x1 - x0)[of])[:, None],
                ys=(y0[of] + along * (y1 - y0)[of])[:, None],
                electrons=electrons[of] / pieces[of],
            )

        return LitFrame(frame, light, self.noise_key(exposure), Converter(self.profile, frame))


PARTICLE_KINDS: Final = (
    FaultKind(
        ProtonStreaksSettings,
        ProtonStreaks,
        what="Protons leave dots and streaks, other ones in each frame, as in the South Atlantic anomaly "
        "(some hundred a cm2 and second behind shielding) or in a solar event (thousands).",
        obc_sees="spots_detected rises in lost in space, cycles with it; at high rates acquisitions take "
        "longer or give NO_MATCH or TOO_MANY_SPOTS. In tracking attitudes stay valid and right; single "
        "stars fall out or have a larger residual.",
        afterwards="The next frame is as before.",
    ),
)
