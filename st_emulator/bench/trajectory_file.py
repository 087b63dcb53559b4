"""A scenario's trajectory in a file: read once, kept in the scenario, so that a journal can do without it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from ..clock import NS_PER_S
from ..errors import ConfigurationError
from ..world.aem import is_aem, samples_of_aem
from ..world.attitude_file import mounted, samples_of_csv
from ..world.sampled import SampledTrajectory
from .scenario import Scenario
from .trajectory_sections import FileTrajectory

MOST_BYTES = 256_000_000


def with_content(scenario: Scenario) -> Scenario:
    """The scenario, with the text of its trajectory's file in it where it has one.

    Raises:
        ConfigurationError: the file cannot be read.
    """
    item = scenario.trajectory
    if not isinstance(item, FileTrajectory) or item.content is not None:
        return scenario
    content = _read(scenario, item)
    return scenario.model_copy(update={"trajectory": item.model_copy(update={"content": content})})


def _read(scenario: Scenario, item: FileTrajectory) -> str:
    path = Path(item.path).expanduser()
    if not path.is_absolute() and scenario.origin:
        path = Path(scenario.origin).parent / path
    what = f"{scenario.where}: trajectory.path: {path}"
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ConfigurationError(f"{what}: larger than {MOST_BYTES:_} bytes")
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise ConfigurationError(
            f"{what}: cannot be read: {reason}; allowed are an AEM (CCSDS 504.0) and CSV"
        ) from error


def sampled_of(scenario: Scenario, item: FileTrajectory, start_tai_ns: int) -> SampledTrajectory:
    """The samples of a file trajectory.

    Raises:
        ValueError: names the file, the place in it and what is allowed.
        ConfigurationError: it cannot be read.
    """
    content = item.content if item.content is not None else _read(scenario, item)
    kind = item.format or ("aem" if is_aem(content) else "csv")
    try:
        made = _sampled(content, kind, item.quaternion, item.q_body_to_sensor, start_tai_ns)
    except ValueError as error:
        raise ValueError(f"{item.path} ({kind}): {error}") from error
    first_ns, last_ns = made.first_ns, made.last_ns
    assert first_ns is not None
    assert last_ns is not None
    if first_ns > 0 or last_ns <= 0:
        raise ValueError(
            f"{item.path} ({kind}): reaches from {first_ns / NS_PER_S:.9g} s to {last_ns / NS_PER_S:.9g} s "
            "after power-on; allowed is a file that holds the power-on, at start_utc = "
            f"{scenario.start_utc.isoformat()}"
        )
    return made


@lru_cache(maxsize=2)
def _sampled(
    content: str, kind: str, direction: str, q_body_to_sensor: tuple[float, ...], start_tai_ns: int
) -> SampledTrajectory:
    if kind == "aem":
        if direction != "icrs_to_body":
            raise ValueError("quaternion = 'body_to_icrs' is of CSV; an AEM says its direction itself")
        return mounted(samples_of_aem(content, start_tai_ns), q_body_to_sensor)
    return mounted(samples_of_csv(content, start_tai_ns, direction), q_body_to_sensor)


def truth_ends_ns(scenario: Scenario, start_tai_ns: int) -> int | None:
    """The virtual time at which a scenario's trajectory ends; None: never. Raises as `sampled_of`."""
    item = scenario.trajectory
    return sampled_of(scenario, item, start_tai_ns).last_ns if isinstance(item, FileTrajectory) else None
