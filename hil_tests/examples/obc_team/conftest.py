"""The flight computer under test: compiled once, started beside the star tracker of each test."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

SOURCE = Path(__file__).parent / "obc" / "obc.c"
FLAGS = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror"]


class FlightComputer:
    """The program `obc`, and what it has said so far."""

    def __init__(self, *arguments: object) -> None:
        self.said: list[str] = []
        self._process = subprocess.Popen(
            [*map(str, arguments)], stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
        )
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.said.append(line.strip())

    @property
    def state(self) -> str:
        """The last of LISTENING, POINTING, SAFE invalid and SAFE silence."""
        states = [line for line in self.said if line.startswith(("LISTENING", "POINTING", "SAFE"))]
        return states[-1] if states else "starting"

    @property
    def attitudes(self) -> list[tuple[int, list[float]]]:
        """The attitudes that it used: frame, quaternion."""
        words = [line.split() for line in self.said if line.startswith("ATTITUDE")]
        return [(int(frame), [float(part) for part in parts]) for _, frame, *parts in words]

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._listener.join()
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled flight software."""
    compiler = shutil.which("gcc")
    if compiler is None:
        missing = "gcc is missing; on Debian, as root: apt-get install gcc libc6-dev"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
    built = tmp_path_factory.mktemp("obc") / "obc"
    subprocess.run([compiler, *FLAGS, "-o", str(built), str(SOURCE)], check=True)
    return built


@pytest.fixture
def start(program: Path, bench: Any) -> Iterator[Callable[[Any], FlightComputer]]:
    """Starts a flight computer for a star tracker and waits until it listens."""
    started = []

    def beside(star_tracker: Any) -> FlightComputer:
        apid = star_tracker.profile.apid
        if star_tracker.on_can:
            made = FlightComputer(program, "can", star_tracker.device, star_tracker.node, apid)
        else:
            made = FlightComputer(program, "serial", star_tracker.device, apid)
        started.append(made)
        bench.until(lambda: made.state != "starting")
        return made

    yield beside
    for one in started:
        one.close()


@pytest.fixture
def flight(start: Callable[[Any], FlightComputer], star_tracker: Any) -> FlightComputer:
    """The flight computer of the star tracker under test."""
    return start(star_tracker)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("vcan") is not None and "vcan0" not in [n for _, n in socket.if_nameindex()]:
        pytest.skip("no vcan0: sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up")
