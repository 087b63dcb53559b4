"""Cases spread over processes or a Dask cluster, with progress and kept outcomes.

Outcomes do not depend on how many workers there are, on the batches, or on how often the campaign was stopped
and gone on with: each case is a function of its own number.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from types import TracebackType
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from ..errors import ConfigurationError
from .batches import FAILED, REFUSED, Batch, BatchOutcome
from .outcome_codec import decode, outcome_type
from .pools import DaskCluster, Here, LocalProcesses, Pool
from .results_file import ResultsFile, program_fingerprint

MOST_TRIES = 3  # of a case that fails, or whose worker dies while it is there alone
FEW_CASES = 4  # not worth the start of processes

Case = TypeVar("Case")
Outcome = TypeVar("Outcome")


class CaseError(ConfigurationError):
    """A case of a campaign failed, or ended its worker, each time it was tried; the message names it."""


class Progress:
    """A progress bar; quiet where there is no terminal."""

    def __init__(self, console: Console, title: str) -> None:
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._title = title

    def __enter__(self) -> Progress:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    @contextlib.contextmanager
    def task(self, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
        """Count up to ``total`` from ``done``; the yielded function counts one."""
        task = self._bar.add_task(self._title, total=total, completed=done)
        try:
            yield lambda: self._bar.advance(task)
        finally:
            self._bar.remove_task(task)


class Workers:
    """Maps a function over cases, outcomes in the order of the cases.

    count: processes (None: one a core). dask: address of a Dask scheduler instead. results: outcomes that are
    there already, and where new ones go.
    """

    def __init__(
        self,
        count: int | None,
        progress: Progress,
        *,
        dask: str | None = None,
        results: ResultsFile | None = None,
    ) -> None:
        self.count = count if count is not None else (os.cpu_count() or 1)
        self.progress = progress
        self.dask = dask
        self.results = results
        self.done = 0  # cases whose outcomes are there, of all stages
        self.resumed = 0  # of these, how many were there before
        self._stages = itertools.count()

    def map(
        self, function: Callable[[Case], Outcome], cases: Sequence[Case], *, batch: int = 1
    ) -> list[Outcome]:
        """``function(case)`` of every case, ``batch`` of them at a time in a worker.

        ``function`` must be picklable (a module's function or a partial of one) and say what it returns; see
        outcome_codec. A campaign calls this in the same order each time.

        Raises:
            CaseError: a case failed, or ended its worker, MOST_TRIES times.
            ConfigurationError: raised by a case, or the cluster is out of reach.
        """
        stage = next(self._stages)
        kind = outcome_type(function)
        kept = self.results.kept(stage) if self.results is not None else {}
        outcomes = {index: decode(kind, kept[index]) for index in range(len(cases)) if index in kept}
        missing = [index for index in range(len(cases)) if index not in outcomes]
        self.done += len(outcomes)
        self.resumed += len(outcomes)
        with self.progress.task(len(cases), len(outcomes)) as advance:

            def record(indices: Sequence[int], encoded: Sequence[Any]) -> None:
                if self.results is not None and indices:
                    self.results.append(stage, indices, encoded)
                for index, item in zip(indices, encoded, strict=True):
                    outcomes[index] = decode(kind, item)
                    self.done += 1
                    advance()

            if missing:
                with self._pool(len(missing)) as pool:
                    _Run(pool, function, cases, record).through(missing, batch)
        return [outcomes[index] for index in range(len(cases))]

    def _pool(self, missing: int) -> Pool:
        if self.dask is not None:
            return DaskCluster(self.dask)
        if self.count == 1 or missing < FEW_CASES:
            return Here()
        return LocalProcesses(self.count)


class _Run:
    """The cases of one map on their way through a pool."""

    def __init__(
        self,
        pool: Pool,
        function: Callable[[Any], Any],
        cases: Sequence[Any],
        record: Callable[[Sequence[int], Sequence[Any]], None],
    ) -> None:
        self._pool = pool
        self._function = function
        self._cases = cases
        self._record = record
        self._waiting: deque[Sequence[int]] = deque()
        self._suspects: deque[int] = deque()  # were with a worker that died: each runs alone
        self._running: dict[Future[BatchOutcome], Sequence[int]] = {}
        self._tries: Counter[int] = Counter()
        self._alone = False

    def through(self, indices: Sequence[int], batch: int) -> None:
        """Run all of them, ``batch`` at a time."""
        self._waiting.extend(indices[first : first + batch] for first in range(0, len(indices), batch))
        broken = False
        while self._waiting or self._suspects or self._running:
            if broken and not self._running:
                self._pool.restart()
                broken = False
            if not broken:
                self._fill()
            done, _ = wait(self._running, return_when=FIRST_COMPLETED)
            for future in done:
                broken |= self._taken(self._running.pop(future), future)

    def _fill(self) -> None:
        """Give the pool work, so that no worker waits; what may have ended a worker goes alone."""
        if self._suspects:
            if not self._running:
                self._alone = True
                self._submit([self._suspects.popleft()])
            return
        self._alone = False
        while self._waiting and len(self._running) < self._pool.ahead:
            self._submit(self._waiting.popleft())

    def _submit(self, indices: Sequence[int]) -> None:
        batch = Batch(self._function, tuple(self._cases[index] for index in indices))
        self._running[self._pool.submit(batch)] = indices

    def _taken(self, indices: Sequence[int], future: Future[BatchOutcome]) -> bool:
        """Take what a batch gave; True when its worker died."""
        try:
            outcome = future.result()
        except CancelledError as error:
            raise ConfigurationError(f"{self._pool.name}: the cases were cancelled or it is gone") from error
        except self._pool.deaths as error:
            for index in indices:
                if self._alone:
                    self._tries[index] += 1
                    if self._tries[index] >= self._pool.most_deaths:
                        raise CaseError(
                            f"case {index} ({self._cases[index]}): its worker died each time it was tried"
                        ) from error
                self._suspects.append(index)
            return True
        if self._pool.elsewhere and outcome.program != program_fingerprint():
            raise ConfigurationError(f"{self._pool.name}: a worker has another version of st-emulator")
        good = [
            (index, item) for index, (word, item) in zip(indices, outcome.items, strict=True) if word == ""
        ]
        self._record([index for index, _ in good], [item for _, item in good])
        for index, (word, item) in zip(indices, outcome.items, strict=True):
            if word == REFUSED:
                raise ConfigurationError(item)
            if word == FAILED:
                self._tries[index] += 1
                if self._tries[index] >= MOST_TRIES:
                    raise CaseError(f"case {index} ({self._cases[index]}) failed {MOST_TRIES} times: {item}")
                self._waiting.append([index])
        return False
