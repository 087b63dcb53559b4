"""The identification algorithms by the names that unit files give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from . import brightness_referenced, geometric_voting, multi_poles, pyramid
from .interface import IdentificationAlgorithm

ALGORITHMS: Final[Mapping[str, IdentificationAlgorithm]] = {
    "pyramid": pyramid.identify,
    "brightness_referenced": brightness_referenced.identify,
    "geometric_voting": geometric_voting.identify,
    "multi_poles": multi_poles.identify,
}
