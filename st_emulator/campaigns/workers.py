"""Cases spread over processes, with progress; the results do not depend on how many processes there are."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from types import TracebackType
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

AHEAD = 8  # cases in the pool for each worker, so that none waits for work

Case = TypeVar("Case")
Outcome = TypeVar("Outcome")


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
    def task(self, total: int) -> Iterator[Callable[[], None]]:
        """Count up to ``total``; the yielded function counts one."""
        task = self._bar.add_task(self._title, total=total)
        try:
            yield lambda: self._bar.advance(task)
        finally:
            self._bar.remove_task(task)


class Workers:
    """Maps a function over cases on several processes, outcomes in the order of the cases."""

    def __init__(self, count: int | None, progress: Progress) -> None:
        self.count = count if count is not None else (os.cpu_count() or 1)
        self.progress = progress

    def map(self, function: Callable[[Case], Outcome], cases: Sequence[Case]) -> list[Outcome]:
        """``function`` must be picklable (a module's function or a partial of one)."""
        with self.progress.task(len(cases)) as advance:
            if self.count == 1 or len(cases) < 4:
                outcomes = []
                for case in cases:
                    outcomes.append(function(case))
                    advance()
                return outcomes
            return self._spread(function, cases, advance)

    def _spread(
        self, function: Callable[[Case], Outcome], cases: Sequence[Case], advance: Callable[[], None]
    ) -> list[Outcome]:
        """Over processes, in batches, so that a stop is soon: a batch is what the workers still finish."""
        context = multiprocessing.get_context("forkserver")
        pool = ProcessPoolExecutor(
            self.count, mp_context=context, initializer=_leave_interrupts_to_the_parent
        )
        try:
            results: dict[int, Outcome] = {}
            waiting = iter(enumerate(cases))
            running: dict[Future[Outcome], int] = {}
            while True:
                for index, case in itertools.islice(waiting, AHEAD * self.count - len(running)):
                    running[pool.submit(function, case)] = index
                if not running:
                    break
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    results[running.pop(future)] = future.result()
                    advance()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        pool.shutdown()
        return [results[index] for index in range(len(cases))]


def _leave_interrupts_to_the_parent() -> None:
    """A terminal's Ctrl-C reaches every process of the group; the parent alone acts on it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
