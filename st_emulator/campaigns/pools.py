"""Where batches run: in this process, in processes of this computer, or on a Dask cluster."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait as wait_for_any
from types import TracebackType
from typing import Any, Protocol, Self

from ..errors import ConfigurationError
from .batches import Batch, BatchOutcome, run_batch

AHEAD = 4  # batches in a pool for each worker, so that none waits for work
CONNECT_S = 10.0


class Pool(Protocol):
    """Takes batches. A context manager: on an exception it drops what it has not begun.

    name: for messages. elsewhere: its workers may have another program than this process. ahead: how many
    batches it should have at a time. deaths: what a batch's future raises when its worker has died;
    most_deaths: how often a case that is there alone may see that.
    """

    name: str
    elsewhere: bool
    ahead: int
    deaths: tuple[type[BaseException], ...]
    most_deaths: int

    def submit(self, batch: Batch) -> Future[BatchOutcome]: ...

    def restart(self) -> None:
        """Be ready for batches again after a death; called when none is there."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Here:
    """This process, at once."""

    name = "this process"
    elsewhere = False
    ahead = 1
    deaths: tuple[type[BaseException], ...] = ()
    most_deaths = 1

    def submit(self, batch: Batch) -> Future[BatchOutcome]:
        future: Future[BatchOutcome] = Future()
        future.set_result(run_batch(batch))
        return future

    def restart(self) -> None:
        """Nothing dies here."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


class LocalProcesses:
    """Processes of this computer. When one dies all are started anew."""

    name = "processes of this computer"
    elsewhere = False
    deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    most_deaths = 3

    def __init__(self, count: int) -> None:
        self.ahead = AHEAD * count
        self._count = count
        self._executor = self._started()

    def _started(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("forkserver")
        return ProcessPoolExecutor(self._count, mp_context=context, initializer=_be_a_worker)

    def submit(self, batch: Batch) -> Future[BatchOutcome]:
        try:
            return self._executor.submit(run_batch, batch)
        except BrokenProcessPool as error:  # died since the last batch came back
            future: Future[BatchOutcome] = Future()
            future.set_exception(error)
            return future

    def restart(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)
        self._executor = self._started()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=kind is None, cancel_futures=kind is not None)


def _be_a_worker() -> None:
    """A terminal's Ctrl-C reaches every process of the group; the parent alone acts on it. Without a parent
    (killed) a worker ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait_for_any([sentinel])
    os._exit(1)


class DaskCluster:
    """A cluster of dask.distributed. The scheduler gives the cases of a lost worker to another; a case that
    takes worker after worker with it comes back as a death.
    """

    elsewhere = True
    most_deaths = 1

    def __init__(self, address: str) -> None:
        self.name = f"--dask {address}"
        try:
            distributed: Any = importlib.import_module("distributed")
        except ImportError as error:
            raise ConfigurationError(
                f"{self.name}: the package distributed is missing: pip install 'st-emulator[dask]'"
            ) from error
        self.deaths: tuple[type[BaseException], ...] = (distributed.KilledWorker,)
        try:
            self._client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError, RuntimeError, ImportError, AssertionError) as error:
            # AssertionError: on a computer that is too busy the client's own loop did not start in its time.
            raise ConfigurationError(f"{self.name}: no scheduler there: {error}") from error
        threads = sum(self._client.nthreads().values())
        self.ahead = AHEAD * max(1, threads)
        self._executor = self._client.get_executor(pure=False)

    def submit(self, batch: Batch) -> Future[BatchOutcome]:
        future: Future[BatchOutcome] = self._executor.submit(run_batch, batch)
        return future

    def restart(self) -> None:
        """The cluster starts its workers itself."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=False)
        self._client.close()
