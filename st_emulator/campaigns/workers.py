"""Cases spread over processes, with progress; the results do not depend on how many processes there are."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from types import TracebackType
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

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
            context = multiprocessing.get_context("forkserver")
            with ProcessPoolExecutor(self.count, mp_context=context) as pool:
                futures = {pool.submit(function, case): index for index, case in enumerate(cases)}
                results: dict[int, Outcome] = {}
                for future in as_completed(futures):
                    results[futures[future]] = future.result()
                    advance()
                return [results[index] for index in range(len(cases))]
