"""Times to the octet: the line's ten bits, the latency of a command, the pause before the reply."""

from __future__ import annotations

import pytest

from hil_tests.dialects.nos3 import client
from hil_tests.dialects.nos3.bench import MS, idle, make, unit

SECOND_NS = 1_000_000_000


def line_ns(octets: int, baud: int = 115200) -> int:
    return octets * 10 * SECOND_NS // baud


@pytest.mark.parametrize("latency_us", [0, 500, 3000])
@pytest.mark.parametrize("delay_us", [0, 1, 700, 40_000])
def test_echo_and_reply_leave_when_they_should(latency_us, delay_us):
    bench = make(
        unit(autonomous=False, reply_delay_us=delay_us, timing={"telecommand_latency_us": latency_us})
    ).boot()
    start_ns = bench.now_ns
    bench.put(client.command("housekeeping"))
    bench.run(100)
    echo_ns = start_ns + line_ns(9) + latency_us * 1000 + line_ns(9)
    reply_ns = echo_ns + delay_us * 1000 + line_ns(8)
    assert [(t_ns, len(group)) for t_ns, group in bench.groups] == [(echo_ns, 9), (reply_ns, 8)]


@pytest.mark.parametrize("baud", [9600, 19200, 115200, 460800])
@pytest.mark.parametrize("layout", ["code", "readme"])
def test_the_data_reply_at_other_rates(baud, layout):
    bench = make(unit(autonomous=False, layout=layout), baud=baud).boot()
    start_ns = bench.now_ns
    bench.put(client.command("data", 0, layout))
    bench.run(100)
    octets = client.reply_size("data", layout)
    end_ns = start_ns + line_ns(9, baud) + 500_000 + line_ns(9, baud) + line_ns(octets, baud)
    assert bench.groups[-1][0] == end_ns
    assert len(bench.sent) == 9 + octets


@pytest.mark.parametrize("name", ["noop", "housekeeping", "data"])
@pytest.mark.parametrize("unit_name", ["roja1", "zy3", "aps_rs"])
def test_the_driver_does_not_wait_in_vain(unit_name, name):
    """50 ms for the echo from the write on, 50 ms for the reply behind it."""
    bench = make(unit(unit_name, autonomous=False)).boot()
    start_ns = bench.now_ns
    bench.put(client.command(name))
    bench.run(100)
    assert bench.groups[0][1] == client.command(name)
    assert bench.groups[0][0] - start_ns < 50 * MS
    assert bench.groups[-1][0] - bench.groups[0][0] < 50 * MS
    assert len(bench.sent) == 9 + client.reply_size(name)


def test_a_reply_may_be_made_too_late_for_the_driver():
    bench = idle(reply_delay_us=60_000)
    bench.put(client.command("housekeeping"))
    bench.run(100)
    assert bench.groups[1][0] - bench.groups[0][0] > 50 * MS


def test_a_command_begins_its_turn_when_the_answer_before_has_left():
    bench = idle(reply_delay_us=2000)
    start_ns = bench.now_ns
    bench.put(client.command("housekeeping") + client.command("noop") + client.command("data"))
    bench.run(100)
    first = start_ns + line_ns(9) + 500_000
    echo_1 = first + line_ns(9)
    reply_1 = echo_1 + 2_000_000 + line_ns(8)
    echo_2 = reply_1 + line_ns(9)
    echo_3 = echo_2 + line_ns(9)
    reply_3 = echo_3 + 2_000_000 + line_ns(13)
    times = [t_ns for t_ns, _ in bench.groups]
    assert times == [echo_1, reply_1, echo_2, echo_3, reply_3]


def test_trailing_octets_delay_nothing():
    times = []
    for trailing in (b"", b"\xde\xad", b"\x55" * 300):
        bench = idle()
        bench.put(client.command("housekeeping") + trailing)
        bench.run(100)
        times.append([t_ns for t_ns, _ in bench.groups])
    assert times[0] == times[1] == times[2]


def test_garbage_before_delays_by_its_own_octets():
    bench = idle()
    start_ns = bench.now_ns
    bench.put(b"\xde" * 7 + client.command("noop"))
    bench.run(20)
    assert bench.groups[0][0] == start_ns + line_ns(16) + 500_000 + line_ns(9)


def test_the_reply_holds_what_is_true_when_its_turn_comes():
    """The counter of a command behind another: its turn is behind the answer, not when it came."""
    bench = idle(reply_delay_us=30_000)
    bench.put(client.command("noop") + client.command("housekeeping"))
    bench.run(100)
    assert client.decode("housekeeping", bench.take()[18:]) == {"count": 3}
