"""`--dask`: a cluster on this computer's loopback; dying workers lose nothing."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from functools import partial

import pytest
from distributed import LocalCluster

from hil_tests.campaigns import cases
from st_emulator.campaigns import batches, pools
from st_emulator.campaigns.workers import CaseError
from st_emulator.errors import ConfigurationError

SQUARES = [index * index for index in range(30)]


def cluster(**more) -> LocalCluster:
    """Two workers; all that it listens on is on loopback."""
    return LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        protocol="tcp",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        **more,
    )


@pytest.fixture(scope="module")
def threads() -> Iterator[str]:
    """Workers of this process."""
    with cluster(processes=False) as here:
        yield here.scheduler_address


@pytest.fixture
def processes() -> Iterator[str]:
    """Workers that can die, and are started anew when they do."""
    with cluster(processes=True) as here:
        yield here.scheduler_address


def test_the_cluster_is_on_loopback(threads):
    assert threads.startswith("tcp://127.0.0.1:")


@pytest.mark.parametrize("batch", [1, 7])
def test_outcomes_in_the_order_of_the_cases(workers, threads, batch):
    ours = workers(None, dask=threads)
    assert ours.map(cases.square, range(30), batch=batch) == SQUARES
    assert ours.map(cases.square, range(2)) == SQUARES[:2]  # however few: where the user wants them
    assert ours.map(cases.square, []) == []


def test_outcomes_of_a_cluster_are_kept(workers, threads, results):
    with pytest.raises(CaseError, match=r"case 29 \(29\) failed 3 times"):
        workers(None, dask=threads, results=results()).map(partial(cases.always_fails, 29), range(30))
    there = results().kept(0)
    assert there
    assert 29 not in there
    here = workers(1, results=results())  # what a cluster began goes on anywhere
    assert here.map(cases.square, range(30)) == SQUARES
    assert here.resumed == len(there)


def test_failing_cases_run_again(workers, threads, tmp_path):
    function = partial(cases.fails_once, str(tmp_path))
    assert workers(None, dask=threads).map(function, range(30), batch=4) == SQUARES


def test_what_the_user_can_mend_is_told(workers, threads):
    with pytest.raises(ConfigurationError, match=r"^the unit is none for this"):
        workers(None, dask=threads).map(cases.refuses, range(30))


def test_dying_workers_lose_nothing(workers, processes, results, tmp_path):
    function = partial(cases.dies_once, str(tmp_path), (3, 20))
    assert workers(None, dask=processes, results=results()).map(function, range(30), batch=5) == SQUARES
    assert {path.name for path in tmp_path.iterdir()} >= {"3", "20"}
    assert results().kept(0) == dict(enumerate(SQUARES))


@pytest.mark.slow
def test_a_case_that_always_ends_its_worker_is_named(workers, processes, results):
    with pytest.raises(CaseError, match=r"case 11 \(11\): its worker died"):
        workers(None, dask=processes, results=results()).map(
            partial(cases.always_dies, 11), range(30), batch=6
        )
    there = results().kept(0)
    assert there
    assert 11 not in there


def test_a_worker_with_another_program_is_refused(workers, threads, monkeypatch):
    monkeypatch.setattr(batches, "program_fingerprint", lambda: "another")
    with pytest.raises(ConfigurationError, match=r"--dask .*: a worker has another version of st-emulator"):
        workers(None, dask=threads).map(cases.square, range(30))


def test_no_scheduler(workers, monkeypatch):
    monkeypatch.setattr(pools, "CONNECT_S", 0.5)
    with socket.socket() as taken:  # bound, not listening: nobody answers there
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ConfigurationError, match=f"--dask {address}: no scheduler there"):
            workers(None, dask=address).map(cases.square, range(3))


@pytest.mark.parametrize("address", ["nonsense://x", "", "127.0.0.1:99999", "tcp://127.0.0.1"])
def test_an_address_that_is_none(workers, monkeypatch, address):
    monkeypatch.setattr(pools, "CONNECT_S", 0.5)
    with pytest.raises(ConfigurationError, match="--dask"):
        workers(None, dask=address).map(cases.square, range(3))


def test_without_the_package(workers, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        ConfigurationError, match=r"distributed is missing: pip install 'st-emulator\[dask\]'"
    ):
        workers(None, dask="tcp://127.0.0.1:8786").map(cases.square, range(3))
