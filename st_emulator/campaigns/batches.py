"""A batch of cases as a worker runs it, wherever that is."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..compiled_kernels import keep_compiled_kernels
from ..errors import ConfigurationError
from .outcome_codec import encode
from .results_file import program_fingerprint

FAILED, REFUSED = "failed", "refused"
# A worker of a cluster may have several threads; the scenes that campaigns keep between cases are for one.
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Batch:
    """A function and the cases that it is called with."""

    function: Callable[[Any], Any]
    cases: tuple[Any, ...]


@dataclass(frozen=True)
class BatchOutcome:
    """program: fingerprint of the worker's program. items: for each case ("", its outcome as JSON holds it),
    (FAILED, why) or (REFUSED, the message for the user).
    """

    program: str
    items: tuple[tuple[str, Any], ...]


def run_batch(batch: Batch) -> BatchOutcome:
    """Run the cases of a batch; one that fails does not take the others with it."""
    items: list[tuple[str, Any]] = []
    with _one_at_a_time:
        keep_compiled_kernels()
        for case in batch.cases:
            try:
                items.append(("", encode(batch.function(case))))
            except ConfigurationError as error:
                items.append((REFUSED, str(error)))
            except Exception as error:
                where = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{where.filename.rpartition('/')[2]}, line {where.lineno}"
                items.append((FAILED, f"{type(error).__name__}: {error} ({place})"))
    return BatchOutcome(program_fingerprint(), tuple(items))
