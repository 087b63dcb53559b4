"""Every command in every layout and quirk, over the line, read by a decoder of the tests' own."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.dialects.nos3 import client
from hil_tests.dialects.nos3.bench import Bench, cut, idle, make, unit

IDENTITY = {"q0": 32768, "q1": 32768, "q2": 32768, "q3": 65535, "valid": 0}
GARBAGE = [b"", b"\x00", b"\xde", b"\xde\xad", b"\xbe\xef", bytes.fromhex("dead01000000"), b"\xff" * 20]


@pytest.fixture(params=["roja1", "zy3"])
def bench(request: pytest.FixtureRequest) -> Bench:
    return make(unit(request.param, autonomous=False)).boot()


def test_every_command(bench):
    assert bench.ask("noop") is None  # the echo and nothing else
    assert bench.ask("housekeeping") == {"count": 3}
    assert bench.ask("data") == IDENTITY
    assert bench.ask("housekeeping") == {"count": 7}


def test_the_octets_of_an_exchange(bench):
    """By hand: two echoes; count 1 of the first command; no attitude: identity, not valid."""
    bench.put(bytes.fromhex("dead 01 00000000 beef dead 02 00000000 beef"))
    bench.run(20)
    assert bench.take() == bytes.fromhex(
        "dead 01 00000000 beef  dead 00000001 beefdead 02 00000000 beef  dead 8000 8000 8000 ffff 00 beef"
    )


def test_it_speaks_only_when_asked(bench):
    bench.run(3000)
    assert bench.take() == b""
    assert bench.emulator.dialect.messages_sent == 0


@pytest.mark.parametrize("payload", [0, 1, 0xDEADBEEF, 0xBEEFDEAD, 0xFFFFFFFF])
@pytest.mark.parametrize("name", ["noop", "housekeeping", "data"])
def test_the_payload_comes_back_in_the_echo(bench, name, payload):
    bench.ask(name, payload)  # compares


@pytest.mark.parametrize("number", [3, 4, 127, 0xDE, 255])
def test_unknown_commands_are_met_with_silence_and_count_one(bench, number):
    assert bench.count() == 1
    bench.put(client.raw_command(number))
    bench.run(20)
    assert bench.take() == b""
    assert bench.count() == 4


@pytest.mark.parametrize(
    "octets",
    [
        "dead 01 00000000 be00",
        "dead 01 00000000 00ef",
        "dead 01 00000000 efbe",
        "de00 01 00000000 beef",
        "00ad 01 00000000 beef",
        "adde 01 00000000 beef",
        "dead 01 000000 beef 00",
        "dead 01 0000000000 beef",
        "c0 18 00 c0",
    ],
)
def test_malformed_commands_are_met_with_silence_and_count_nothing(bench, octets):
    bench.put(bytes.fromhex(octets))
    bench.run(20)
    assert bench.take() == b""
    assert bench.count() == 1


@pytest.mark.parametrize("garbage", GARBAGE, ids=lambda junk: junk.hex() or "none")
def test_with_garbage_before_between_and_behind(garbage):
    bench = idle()
    names = ["housekeeping", "data", "noop", "housekeeping"]
    commands = [client.command(name) for name in names]
    bench.put(garbage + garbage.join(commands) + garbage)
    bench.run(100)
    decoder = client.Decoder(octets=bytearray(bench.take()))
    answers = decoder.answers(list(zip(names, commands, strict=True)))
    assert not decoder.octets
    assert [answer.reply for answer in answers] == [{"count": 1}, IDENTITY, None, {"count": 7}]


def test_octet_by_octet_with_long_pauses():
    bench = idle()
    for octet in client.command("housekeeping"):
        assert bench.take() == b""
        bench.put(bytes([octet]))
        bench.run(3000 if octet == 0xAD else 50)
    assert client.decode("housekeeping", bench.take()[9:]) == {"count": 1}


@pytest.fixture(scope="module")
def one_bench() -> Bench:
    return make(unit(autonomous=False))


def after_power_on(bench: Bench, pieces: list[bytes]) -> list[tuple[int, bytes]]:
    """What a unit fresh from its boot sends for pieces, with times from their put on."""
    bench.emulator.device.power_off()
    bench.emulator.device.power_on()
    bench.boot()
    bench.take()
    start_ns = bench.now_ns
    bench.put(*pieces)
    bench.run(60)
    return [(t_ns - start_ns, group) for t_ns, group in bench.groups]


@settings(max_examples=100)
@given(
    st.lists(
        st.one_of(st.binary(max_size=12), st.sampled_from([client.raw_command(n) for n in range(5)])),
        min_size=1,
        max_size=8,
    ).map(b"".join),
    st.lists(st.integers(0, 60), max_size=8),
)
def test_pieces_put_at_once_are_answered_at_the_same_instants_as_the_whole(one_bench, octets, cuts):
    cuttings = (
        [octets],
        cut(octets, [min(place, len(octets)) for place in cuts]),
        [octets[n : n + 1] for n in range(len(octets))],
    )
    whole, pieces, by_octet = (after_power_on(one_bench, cutting) for cutting in cuttings)
    assert whole == pieces == by_octet
    expected = [nine for _, nine in client.commands_in(octets) if nine[2] <= 2]
    echoes = [group for _, group in whole if len(group) == 9]
    assert echoes == expected
    assert len(whole) == sum(1 + (nine[2] > 0) for nine in expected)


@pytest.mark.parametrize("baud", [9600, 115200, 921600])
def test_behind_a_real_port_pieces_are_reassembled_too(baud):
    bench = make(unit(autonomous=False), pace_reception=False, baud=baud).boot()
    command = client.command("housekeeping")
    bench.put(b"\x00" + command[:4])
    bench.run(10)
    bench.put(command[4:] + command[:2])
    bench.run(30)
    assert bench.take() == command + bytes.fromhex("dead 00000001 beef")
    bench.put(command[2:])
    bench.run(30)
    assert bench.take() == command + bytes.fromhex("dead 00000003 beef")


def test_a_flood_is_answered_in_order_and_bounded():
    """More than the line can answer: each answer that comes is whole and in its turn; then all is well."""
    bench = idle()
    flood = 400
    bench.put(client.command("housekeeping") * flood)
    bench.run(2000)
    octets = bench.take()
    assert len(octets) % 17 == 0
    answered = len(octets) // 17
    assert 64 < answered < flood
    counts = [client.decode("housekeeping", octets[n * 17 + 9 : n * 17 + 17]) for n in range(answered)]
    assert [count["count"] for count in counts] == list(
        range(1, 2 * answered, 2)
    )  # those lost counted nothing
    assert bench.count() == 2 * answered + 1


# -- the counter


def test_the_nth_accepted_command_reads_twice_n_less_one(bench):
    for n in range(1, 30):
        if n % 3 == 0:
            assert bench.count() == 2 * n - 1
        else:
            bench.ask("noop")


def test_the_counter_as_the_readme_says():
    bench = idle(counter="once")
    assert [bench.count() for _ in range(3)] == [1, 2, 3]
    bench.put(client.raw_command(99))  # received, if not accepted
    bench.run(20)
    assert bench.count() == 5


def test_the_counter_wraps():
    bench = idle()
    bench.emulator.dialect._count = 0xFFFFFFFE
    assert bench.count() == 0xFFFFFFFF
    assert bench.count() == 1


# -- layouts and quirks


@pytest.mark.parametrize("unit_name", ["roja1", "zy3"])
def test_the_readmes_layout(unit_name):
    bench = make(unit(unit_name, layout="readme", counter="once", autonomous=False)).boot()
    assert bench.ask("housekeeping") == {"count": 1, "configuration": 0, "status": 0}
    assert bench.ask("config", 0xA1B2C3D4) is None
    assert bench.ask("housekeeping") == {"count": 3, "configuration": 0xA1B2C3D4, "status": 0}
    assert bench.ask("data") == {"count": 4, **IDENTITY}
    bench.put(client.raw_command(3))  # the code's config is none here
    bench.run(20)
    assert bench.take() == b""


def test_config_is_known_by_setting_alone():
    assert client.command("config", 5) == bytes.fromhex("dead 03 00000005 beef")
    bench = idle(config_command="echoed")
    assert bench.ask("config", 5) is None
    assert bench.count() == 3
    silent = idle()
    silent.put(client.command("config", 5))
    silent.run(20)
    assert silent.take() == b""
    assert silent.count() == 2


def test_every_well_formed_command_is_echoed_by_setting():
    bench = idle(echo="every")
    bench.put(client.raw_command(200, 7))
    bench.run(20)
    assert bench.take() == client.raw_command(200, 7)
    assert bench.count() == 3
    bench.put(bytes.fromhex("dead c8 00000007 be00"))  # not this one
    bench.run(20)
    assert bench.take() == b""


def test_a_disabled_unit_is_silent():
    bench = idle(enabled=False)
    for number in range(5):
        bench.put(client.raw_command(number))
    bench.run(500)
    assert bench.take() == b""
    assert bench.emulator.dialect.messages_received == 0


def test_the_reference_simulator_wants_a_command_in_one_write():
    bench = idle(reception="callback")
    command = client.command("housekeeping")
    assert bench.count() == 1
    for pieces in (
        [command[:4], command[4:]],
        [command + b"\x00"],
        [b"\x00" + command],
        [command + command],
        [b"", command[:8]],
    ):
        bench.put(*pieces)
        bench.run(20)
        assert bench.take() == b"", pieces
    bench.put(command, command)  # two writes at one instant are two calls
    bench.run(20)
    assert bench.take() == command + bytes.fromhex("dead 00000003 beef") + command + bytes.fromhex(
        "dead 00000005 beef"
    )


@pytest.mark.parametrize("pace", [True, False])
def test_one_write_is_one_call_also_when_part_of_it_is_lost(pace):
    bench = make(unit(autonomous=False, reception="callback", timing={"boot_ms": 10}), pace_reception=pace)
    bench.run_to(9.5)
    bench.put(client.command("housekeeping"))  # its first octets come while the unit boots
    bench.run_to(40)
    assert bench.take() == b""
    assert bench.count() == 1
