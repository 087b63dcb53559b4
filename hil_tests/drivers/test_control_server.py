"""The control socket from its far end, with a socket of the test's own and a clock that it turns."""

from __future__ import annotations

import json
import random
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from st_emulator.bench.scenario import Scenario
from st_emulator.clock import NS_PER_S
from st_emulator.drivers.control_server import MOST_STRANGERS, ControlServer, loopback_address
from st_emulator.drivers.lockstep import Lockstep
from st_emulator.drivers.lockstep_requests import REQUESTS, Requests
from st_emulator.drivers.lockstep_wire import ERROR_KINDS, MOST_LINE_BYTES
from st_emulator.errors import ConfigurationError
from st_emulator.units.profile import load_unit

TOKEN = "a token of this test"
MS = 1_000_000


class Desk:
    """A server in this thread, a clock that the test turns, and what the person is told."""

    def __init__(self, *, steps: bool = True, scenario: Scenario | None = None, **more: Any) -> None:
        self.now_ns = 0
        self.said: list[str] = []
        self.unit = Lockstep.of(load_unit("roja1"), scenario, **more)
        self.requests = Requests(self.unit, steps=steps)
        self.server = ControlServer(
            ("127.0.0.1", 0), TOKEN, self.requests, self.said.append, now_ns=lambda: self.now_ns
        )
        self.ends: list[FarEnd] = []

    def connect(self) -> FarEnd:
        end = FarEnd(self)
        self.ends.append(end)
        self.server.serve(1)
        return end

    def client(self) -> FarEnd:
        end = self.connect()
        assert end.ask({"do": "hello", "version": 1, "token": TOKEN})["ok"]
        return end

    def close(self) -> None:
        self.server.close()
        for end in self.ends:
            end.socket.close()


class FarEnd:
    """A client made with a socket alone."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self.socket = socket.create_connection(desk.server.address, 10)
        self.socket.settimeout(0.01)
        self.heard = b""

    def put(self, data: bytes) -> None:
        """Send, letting the server take it in between."""
        while data:
            try:
                data = data[self.socket.send(data[: 1 << 16]) :]
            except (TimeoutError, BlockingIOError):
                pass
            except OSError:
                return
            self.desk.server.serve(0)

    def line(self) -> dict[str, Any] | None:
        """The next answer; None when the connection was closed."""
        for _ in range(2000):
            if b"\n" in self.heard:
                line, _, self.heard = self.heard.partition(b"\n")
                answer = json.loads(line)
                assert isinstance(answer["ok"], bool)
                if not answer["ok"]:
                    assert answer["error"]["kind"] in ERROR_KINDS
                    assert answer["error"]["text"]
                return answer
            self.desk.server.serve(0)
            try:
                data = self.socket.recv(1 << 16)
            except TimeoutError:
                continue
            except OSError:
                return None
            if not data:
                return None
            self.heard += data
        raise AssertionError("no answer")

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        self.put(json.dumps(message).encode() + b"\n")
        answer = self.line()
        assert answer is not None
        return answer

    def refused(self, message: dict[str, Any]) -> tuple[str, str]:
        answer = self.ask(message)
        assert not answer["ok"], answer
        return answer["error"]["kind"], answer["error"]["text"]


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    yield made
    made.close()


@pytest.mark.parametrize("text", ["127.0.0.1:0", "localhost:4711", "[::1]:65535", "127.9.9.9:1"])
def test_loopback_is_allowed(text):
    host, port = loopback_address(text, "--lockstep")
    assert port == int(text.rpartition(":")[2])
    assert host in ("127.0.0.1", "::1", "127.9.9.9")


@pytest.mark.parametrize(
    "text",
    ["0.0.0.0:1", "192.168.1.1:80", "[::]:1", "example.org:1", "127.0.0.1", ":5", "", "127.0.0.1:65536",
     "127.0.0.1:-1", "127.0.0.1:x", "127.0.0.1:٣", "[fe80::1%lo]:1", "127.0.0.1:1:2", "10.0.0.1:0"],
)  # fmt: skip
def test_nothing_else_is(text):
    with pytest.raises(ConfigurationError, match=r"^--lockstep .*127\.0\.0\.1:PORT"):
        loopback_address(text, "--lockstep")


def test_a_session(desk):
    end = desk.connect()
    hello = end.ask({"id": "a", "do": "hello", "version": 1, "token": TOKEN})
    assert hello["id"] == "a"
    assert (hello["version"], hello["unit"], hello["time"], hello["truth"]) == (
        1,
        "roja1",
        "lockstep",
        "outside",
    )
    assert end.ask({"id": 7, "do": "step_to", "t_ns": 600 * MS}) == {"id": 7, "ok": True, "now_ns": 600 * MS}
    assert end.ask({"do": "step_frame", "count": 2, "take": True})["now_ns"] == 1000 * MS
    assert end.ask({"do": "truth"})["unit"]["mode"] == "STANDBY"
    assert end.ask({"do": "counters"})["counters"]["boot_count"] == 1
    assert end.ask({"do": "run_until", "condition": {"sent_bytes": 1}, "limit_ns": 9 * NS_PER_S})["met"]
    sent = end.ask({"do": "take"})
    assert sent["sent"]
    assert not sent["more"]
    assert end.ask({"do": "pause"})["paused"]
    assert end.refused({"do": "step_frame"})[0] == "paused"
    assert not end.ask({"do": "resume"})["paused"]
    assert end.ask({"do": "bye"})["ok"]
    assert end.line() is None
    assert desk.unit.paused_because is None
    assert desk.client().ask({"do": "state"})["now_ns"] == desk.unit.now_ns


ATTITUDE = {"do": "set_attitude", "t_ns": 0, "q_icrs_to_sensor": [0, 0, 0, 1]}


@pytest.mark.parametrize(
    ("message", "kind", "says"),
    [
        ({"do": "dance"}, "unknown", "'dance'; allowed are state"),
        ({}, "unknown", "None"),
        ({"do": ["truth"]}, "unknown", "truth"),
        ({"do": "hello", "version": 1, "token": TOKEN}, "unknown", "hello"),
        ({"do": "step_to"}, "argument", "t_ns: found None"),
        ({"do": "step_to", "t_ns": 1.5}, "argument", "whole number"),
        ({"do": "step_to", "t_ns": 2**70}, "argument", "whole number"),
        ({"do": "step_to", "t_ns": 2**62}, "argument", "after the present"),
        ({"do": "step_to", "t_ns": 5, "then": 1}, "argument", "'then' is not an argument; allowed"),
        ({"do": "step_frame", "count": 0}, "argument", "count: found 0"),
        ({"do": "run_until", "limit_ns": 5}, "argument", "condition"),
        ({"do": "run_until", "condition": {"mode": "HAPPY"}, "limit_ns": 5}, "argument", "TRACKING"),
        ({"do": "run_until", "condition": {"moon": 1}, "limit_ns": 5}, "argument", "moon"),
        ({"do": "run_until", "condition": {"counters": {"x": 1}}, "limit_ns": 5}, "argument", "frames_valid"),
        ({"do": "receive", "hex": "c"}, "argument", "hexadecimal"),
        ({"do": "receive"}, "argument", "hexadecimal"),
        ({"do": "receive", "hex": 5}, "argument", "hexadecimal"),
        (ATTITUDE | {"q_icrs_to_sensor": [0, 0, 0]}, "argument", "4 finite numbers"),
        (ATTITUDE | {"rate": [0, 0, 0]}, "argument", "rate: is not a known item"),
        (ATTITUDE | {"t_ns": "1"}, "argument", "t_ns: found '1'"),
        ({"do": "inject"}, "argument", "fault: allowed is a table"),
        ({"do": "inject", "fault": {"kind": "tired"}}, "argument", "tired"),
        ({"do": "inject", "fault": {}}, "argument", "kind"),
        ({"do": "clear"}, "argument", "number: found None"),
        ({"do": "clear", "number": 5}, "argument", "fault 5: there is none"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_told(desk, message, kind, says):
    end = desk.client()
    found, text = end.refused(message)
    assert found == kind
    assert says in text
    assert end.ask({"do": "step_to", "t_ns": 5})["now_ns"] == 5


def test_the_truth_that_is_missing_is_told_and_given():
    desk = Desk(scenario=Scenario(parameters={"autonomous_start": 1}))
    end = desk.client()
    kind, text = end.refused({"do": "step_to", "t_ns": NS_PER_S})
    assert kind == "beyond_truth"
    assert "no sample is given yet" in text
    stopped_ns = end.ask({"do": "state"})["now_ns"]
    assert 0 < stopped_ns < NS_PER_S
    for t_ns in (0, NS_PER_S):
        assert end.ask(ATTITUDE | {"t_ns": t_ns})["ok"]
    assert end.refused(ATTITUDE)[0] == "argument"  # not after the sample before
    assert end.ask({"do": "step_to", "t_ns": NS_PER_S})["now_ns"] == NS_PER_S
    desk.close()


@pytest.mark.parametrize(
    ("lines", "kind"),
    [
        (b'{"do":"truth"}\n', "unauthorised"),
        (b'{"do":"hello","version":1}\n', "unauthorised"),
        (b'{"do":"hello","version":1,"token":"a token of this tesu"}\n', "unauthorised"),
        (b'{"do":"hello","version":1,"token":["a token of this test"]}\n', "unauthorised"),
        (b'{"do":"hello","version":1,"token":"\\ud800"}\n', "unauthorised"),
        (b'{"do":"hello","version":2,"token":"a token of this test"}\n', "version"),
        (b'{"do":"hello","token":"a token of this test"}\n', "version"),
        (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", "malformed"),
        (b"[]\n", "malformed"),
        (b"\xff\xfe\n", "malformed"),
        (b"x" * (MOST_LINE_BYTES + 5), "oversized"),
    ],
)  # fmt: skip
def test_a_stranger_is_told_why_and_let_go(desk, lines, kind):
    end = desk.connect()
    end.put(lines)
    answer = end.line()
    assert answer is not None
    assert answer["error"]["kind"] == kind
    assert end.line() is None
    assert desk.client().ask({"do": "step_to", "t_ns": 1})["ok"]


def test_who_never_says_hello_is_let_go(desk):
    silent = [desk.connect() for _ in range(MOST_STRANGERS)]
    over = desk.connect()
    answer = over.line()
    assert answer is not None
    assert answer["error"]["kind"] == "busy"
    desk.now_ns += 6 * NS_PER_S
    desk.server.serve(0)
    for end in silent:
        answer = end.line()
        assert answer is not None
        assert answer["error"]["kind"] == "unauthorised"
    desk.now_ns += 2 * NS_PER_S
    desk.server.serve(0)
    assert desk.client().ask({"do": "state"})["ok"]


def test_long_and_broken_lines_of_the_client_are_left_out(desk):
    end = desk.client()
    end.put(b'{"do":"step_to","t_ns":9,"x":"' + b"y" * (3 * MOST_LINE_BYTES) + b'"}\n{"id":5,"do":"truth"}\n')
    first, second = end.line(), end.line()
    assert first is not None
    assert second is not None
    assert first["error"]["kind"] == "oversized"
    assert second["id"] == 5
    assert second["unit"]["t_ns"] == 0
    for line in (b"{", b'"x"', b"nul\0", b"[" * 100_000, b'{"do":NaN}', b"\xc3\x28", b"1" * 5000):
        end.put(line + b"\n")
        answer = end.line()
        assert answer is not None
        assert answer["error"]["kind"] == "malformed"
    end.put(b"\n \n\r\n")  # empty lines are nothing
    assert end.ask({"id": 8, "do": "state"})["id"] == 8


def test_lines_come_in_any_pieces(desk):
    end = desk.client()
    for octet in b'{"id":1,"do":"step_to","t_ns":3}\n{"id":2,"do":"step_to","t_ns":4}\n':
        end.put(bytes([octet]))
    answers = [end.line(), end.line()]
    assert [answer and answer["id"] for answer in answers] == [1, 2]
    assert desk.unit.now_ns == 4


def test_a_second_client_is_refused_while_one_is_there(desk):
    first, second = desk.client(), desk.connect()
    answer = second.line()
    assert answer is not None
    assert answer["error"]["kind"] == "busy"
    assert second.line() is None
    assert first.ask({"do": "step_to", "t_ns": 5})["ok"]


def test_a_client_that_dies_leaves_the_unit_paused_and_a_new_one_takes_over(desk):
    first = desk.client()
    first.ask({"do": "step_to", "t_ns": 123 * MS})
    first.put(b'{"id":1,"do":"step_to","t_ns":')
    first.socket.close()
    desk.server.serve(1)
    assert desk.said == [
        "control: the client has gone without a word: the unit is paused at 0.123000000 s; a new client may "
        "take over where it stands"
    ]
    second = desk.connect()
    hello = second.ask({"do": "hello", "version": 1, "token": TOKEN})
    assert (hello["now_ns"], hello["paused"]) == (123 * MS, True)
    assert hello["because"] == "the client has gone without a word"
    assert second.refused({"do": "step_to", "t_ns": 200 * MS})[0] == "paused"
    second.ask({"do": "resume"})
    assert second.ask({"do": "step_to", "t_ns": 200 * MS})["now_ns"] == 200 * MS


def test_a_client_that_stalls_leaves_the_unit_paused_and_may_come_back(desk):
    first = desk.client()
    first.ask({"do": "step_to", "t_ns": 5})
    desk.now_ns += 31 * NS_PER_S
    desk.server.serve(0)
    assert len(desk.said) == 1
    assert "silent for 30 s: the unit is paused at 0.000000005 s" in desk.said[0]
    assert desk.unit.paused_because is not None
    assert first.ask({"do": "step_to", "t_ns": 6})["ok"]
    assert "is back" in desk.said[1]


def test_a_stalled_clients_place_is_taken_by_a_new_one_with_the_token_alone(desk):
    first = desk.client()
    desk.now_ns += 31 * NS_PER_S
    desk.server.serve(0)
    stranger = desk.connect()
    stranger.put(b'{"do":"hello","version":1,"token":"no"}\n')
    assert stranger.line()["error"]["kind"] == "unauthorised"
    second = desk.connect()
    hello = second.ask({"do": "hello", "version": 1, "token": TOKEN})
    assert hello["because"] == "the client has been silent for 30 s"
    told = first.line()
    assert told is not None
    assert told["error"]["kind"] == "taken_over"
    assert first.line() is None
    second.ask({"do": "resume"})
    assert second.ask({"do": "step_frame"})["ok"]
    assert "taken over" in desk.said[-1]


def test_a_pause_that_was_asked_for_stays_through_a_stall(desk):
    end = desk.client()
    end.ask({"do": "pause"})
    desk.now_ns += 31 * NS_PER_S
    desk.server.serve(0)
    assert end.ask({"do": "state"})["because"] == "asked for"


def test_a_client_that_reads_nothing_holds_nobody_up(desk):
    end = desk.client()
    end.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    flood = b'{"do":"truth"}\n' * 1000
    sent = 0
    for _ in range(400):
        try:
            sent += end.socket.send(flood)
        except TimeoutError:
            break
        except OSError:
            break
        desk.server.serve(0)
    assert sent < 400 * len(flood)  # it pushes back, or has given it up
    desk.now_ns += 31 * NS_PER_S
    desk.server.serve(0)
    assert desk.client().ask({"do": "resume"})["ok"]


def test_a_paced_run_serves_faults_truth_and_counters_alone():
    desk = Desk(steps=False, trajectory=None)
    end = desk.client()
    for name, request in REQUESTS.items():
        if request.of_time:
            kind, text = end.refused({"do": name})
            assert (kind, "--lockstep" in text) == ("refused", True), name
    assert end.ask({"do": "truth"})["unit"]["mode"] == "BOOT"
    assert end.ask({"do": "state"})["time"] == "paced"
    end.socket.close()
    desk.server.serve(1)
    assert desk.said == []  # the unit goes on
    desk.close()


def test_faults_are_put_in_and_ended(desk):
    end = desk.client()
    end.ask({"do": "step_to", "t_ns": 700 * MS})
    end.ask({"do": "take"})
    fault = {"kind": "line.silence"}
    number = end.ask({"do": "inject", "fault": fault})["number"]
    assert end.ask({"do": "faults"})["faults"] == [{"number": number, **fault}]
    assert end.ask({"do": "step_to", "t_ns": 4000 * MS, "take": True})["sent"] == []
    assert end.ask({"do": "clear", "number": number})["ok"]
    assert end.ask({"do": "faults"})["faults"] == []
    assert end.ask({"do": "step_to", "t_ns": 8000 * MS, "take": True})["sent"]


def random_line(chance: random.Random) -> bytes:
    """Half-right lines: they reach further than noise."""
    kind = chance.randrange(6)
    if kind == 0:
        return chance.randbytes(chance.randrange(60)).replace(b"\n", b"") + b"\n"
    values: list[Any] = [
        None, True, 0, -1, 1 << 80, 1.5, "", "x" * 50, [], [0, 0, 0, 1], {}, {"mode": "TRACKING"},
        {"valid": False}, {"kind": "line.silence", "start_s": 1},
        {"counters": {"frames_valid": 1}}, "00ff", "c0", 10_000_000, 250_000_000,
    ]  # fmt: skip
    names = ["t_ns", "count", "condition", "limit_ns", "hex", "take", "q_icrs_to_sensor", "rate_rad_s", "x",
             "number", "token", "sun_direction", "fault"]  # fmt: skip
    message = {
        "id": chance.choice(values),
        "do": chance.choice([*REQUESTS, "hello", "", None, 5]),
        **{name: chance.choice(values) for name in chance.sample(names, chance.randrange(4))},
    }
    line = json.dumps(message).encode()
    if kind == 1:
        line = line[: chance.randrange(len(line))]
    elif kind == 2:
        at = chance.randrange(len(line))
        line = line[:at] + chance.randbytes(1).replace(b"\n", b" ") + line[at + 1 :]
    return line + b"\n"


def fuzz(lines: int, seed: int) -> int:
    """So many lines at random to one client's socket: each is answered with one line. Returns the answers."""
    chance = random.Random(seed)
    desk = Desk()
    end = desk.client()
    answered = 0
    for number in range(lines):
        line = random_line(chance)
        end.put(line)
        if not line.strip():
            continue
        answer = end.line()
        assert answer is not None, (number, line)
        answered += 1
        if number % 50 == 0:
            desk.unit.resume()
    assert end.ask({"do": "resume"})["ok"]
    desk.close()
    return answered


def test_lines_at_random_are_answered_one_by_one():
    assert fuzz(3000, seed=5) > 2900


def test_power_is_cut_and_comes_back(desk):
    end = desk.client()
    end.ask({"do": "step_to", "t_ns": 1000 * MS})
    assert end.refused({"do": "power", "on": 1})[0] == "argument"
    assert end.refused({"do": "power"})[0] == "argument"
    assert end.ask({"do": "power", "on": False})["ok"]
    assert end.ask({"do": "state"})["mode"] == "OFF"
    end.ask({"do": "step_to", "t_ns": 2000 * MS})
    assert end.ask({"do": "power", "on": True})["ok"]
    assert end.ask({"do": "state"})["mode"] == "BOOT"
    unit = end.ask({"do": "truth"})["unit"]
    assert (unit["powered"], unit["mode"]) == (True, "BOOT")


def test_the_truth_of_a_frame_is_that_of_its_mid_exposure():
    desk = Desk(trajectory=None, scenario=Scenario(parameters={"autonomous_start": 1}))
    end = desk.client()
    end.ask({"do": "step_to", "t_ns": 3000 * MS})
    last = end.ask({"do": "truth"})["unit"]["last_frame"]
    frame = end.ask({"do": "truth", "frame": last["frame_index"]})["frame"]
    assert frame["time_ns"] == last["exposure_mid_ns"]
    assert frame["q_icrs_to_sensor"] == last["q_true_icrs_to_sensor"]
    assert end.ask({"do": "truth", "frame": "now"})["frame"]["time_ns"] == 3000 * MS
    for wrong in (10**6, -1, "then", 1.5, None):
        assert end.refused({"do": "truth", "frame": wrong})[0] == "argument"
    desk.close()


def test_every_request_and_argument_is_documented():
    page = (Path(__file__).parents[2] / "docs/lockstep.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    for name, request in REQUESTS.items():
        (row,) = [line for line in rows if f"`{name}`" in line.split("|")[1]]
        assert ("*" in row.split("|")[1]) == request.of_time, name
        for argument in request.arguments:
            assert argument == "*" or f"`{argument}`" in row, (name, argument)
