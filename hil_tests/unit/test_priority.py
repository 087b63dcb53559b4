"""The real-time loop goes before other work where the system lets it, and does without where not."""

import os
import threading

import pytest

from st_emulator.drivers import realtime

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="no scheduling policies here")


def mine():
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority


def test_priority_is_given_back():
    before = mine()
    with realtime.ahead_of_others() as ahead:
        if ahead:
            assert mine() == (os.SCHED_FIFO, realtime.LOOP_PRIORITY)
    assert mine() == before


def test_the_worker_goes_with_other_work():
    before = mine()
    with realtime.ahead_of_others():
        worker = realtime.FrameWorker()
        workers = worker.submit(mine).result(10)
        worker.close()
    assert workers == before


def test_without_the_right_all_stays_as_it_is(monkeypatch):
    def refuse(*arguments):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    before = mine()
    with realtime.ahead_of_others() as ahead:
        assert ahead is False
        assert mine() == before


def test_only_the_calling_thread_is_meant():
    seen = []
    before = mine()
    inside, go_on = threading.Event(), threading.Event()

    def look():
        inside.wait(10)
        seen.append(mine())
        go_on.set()

    other = threading.Thread(target=look)
    other.start()
    with realtime.ahead_of_others():
        inside.set()
        assert go_on.wait(10)
    other.join()
    assert seen == [before]
