"""Boot, power, faults and modes, as the wire shows them."""

from __future__ import annotations

import pytest

from hil_tests.dialects.nos3 import client
from hil_tests.dialects.nos3.bench import Bench, idle, make, sky, unit
from hil_tests.dialects.nos3.test_commands import IDENTITY
from st_emulator.bench.emulator import Emulator
from st_emulator.device.commands import Acquire, CaptureImage, GoStandby, Reset, Shutdown
from st_emulator.device.store import StoreContents, VolatileStore
from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.causes import FaultCause, ResetCause, StoreInvalidCause
from st_emulator.firmware_model.modes import Mode
from st_emulator.wire.can.wiring import CanWiring

HOUSEKEEPING = client.command("housekeeping")
LINE_9_MS = 9 * 10 / 115.2


def execute(bench: Bench, command: object) -> None:
    bench.emulator.device.check(command)
    bench.emulator.device.execute(command)


@pytest.mark.parametrize("unit_name", ["roja1", "zy3"])
def test_nothing_is_heard_before_the_boot_is_over(unit_name):
    boot_ms = make(unit(unit_name)).emulator.profile.timing.boot_ms
    for early_ms, answered in ((0.01, False), (-0.01, True)):
        bench = make(unit(unit_name, autonomous=False))
        # The first octet comes just before or just after the end of the boot.
        bench.run_to(boot_ms - 10 / 115.2 - early_ms)
        bench.put(HOUSEKEEPING)
        bench.run(20)
        assert (bench.take() != b"") == answered
    assert bench.count() == 3


def test_after_boot_it_looks_for_its_attitude_by_itself():
    bench = make(unit(), scenario=sky())
    bench.run_to(399)
    assert bench.emulator.device.mode == Mode.BOOT
    bench.run_to(401)
    assert bench.emulator.device.mode == Mode.LOST_IN_SPACE
    assert bench.data() == IDENTITY
    assert bench.until_valid()["valid"] == 1
    assert bench.emulator.device.mode == Mode.TRACKING


def test_it_stays_in_standby_when_it_is_not_autonomous():
    bench = idle()
    bench.run(2000)
    assert bench.emulator.device.mode == Mode.STANDBY
    assert bench.data() == IDENTITY


def test_with_both_autonomies_it_acquires_once():
    bench = make(unit(), scenario=sky(parameters={"autonomous_start": 1})).boot()
    assert bench.emulator.device.mode == Mode.LOST_IN_SPACE
    bench.until_valid()


def test_a_power_cycle_starts_from_nothing():
    bench = make(unit(), scenario=sky()).boot()
    bench.until_valid()
    assert bench.count() > 1
    bench.emulator.device.power_off()
    bench.put(HOUSEKEEPING)
    bench.run(1000)
    assert bench.take() == b""
    bench.emulator.device.power_on()
    bench.put(HOUSEKEEPING)
    bench.run(100)
    assert bench.take() == b""  # it boots
    bench.run(302)
    assert bench.data() == IDENTITY  # nothing of the life before
    assert bench.count() == 3
    bench.until_valid()


@pytest.mark.parametrize("after_octets", [3, 9, 12, 20])
def test_power_lost_at_any_instant_of_an_exchange(after_octets):
    """While the command comes, while it is handled, while echo and reply leave."""
    bench = idle(reply_delay_us=500)
    bench.put(HOUSEKEEPING)
    bench.run(after_octets * 10 / 115.2)
    bench.emulator.device.power_off()
    bench.run(100)
    assert (HOUSEKEEPING + bytes.fromhex("dead 00000001 beef")).startswith(bench.take())
    bench.emulator.device.power_on()
    bench.run(420)
    assert bench.take() == b""  # nothing left over
    assert bench.count() == 1


def test_half_a_command_before_a_power_cycle_is_forgotten():
    bench = idle()
    bench.put(HOUSEKEEPING[:5])
    bench.run(5)
    bench.emulator.device.power_off()
    bench.emulator.device.power_on()
    bench.run(420)
    bench.put(HOUSEKEEPING[5:])
    bench.run(20)
    assert bench.take() == b""
    assert bench.count() == 1


def test_a_reset_lets_the_answer_leave_and_takes_no_more():
    """The wire has no reset; whoever commands one beside it does not cut an answer short."""
    bench = idle(reply_delay_us=5000)
    bench.put(HOUSEKEEPING * 3)
    bench.run(5)  # the first echo has left, two commands wait
    execute(bench, Reset(ResetCause.COLD_RESET))
    bench.run(600)
    assert bench.take() == HOUSEKEEPING + bytes.fromhex("dead 00000001 beef")
    assert bench.count() == 1


def test_a_command_in_its_latency_is_not_taken_on_the_way_down():
    """Its turn would come while the answer before leaves."""
    bench = make(
        unit(autonomous=False, reply_delay_us=5000, timing={"telecommand_latency_us": 3000, "boot_ms": 50})
    ).boot()
    bench.put(HOUSEKEEPING * 2)
    bench.run(4)  # the first is handled at 3.8 ms, the second would be at 4.6 ms
    execute(bench, Reset(ResetCause.COLD_RESET))
    bench.run(100)
    assert bench.take() == HOUSEKEEPING + bytes.fromhex("dead 00000001 beef")


def test_what_waits_for_the_line_is_lost_with_the_power():
    """17 octets are more than the transmitter holds at once (16): the last one stays behind."""
    bench = idle(layout="readme")
    command = client.command("data", 0, "readme")
    bench.put(command)
    bench.run(2 * LINE_9_MS + 0.5 + 0.3)  # in the middle of the reply
    bench.emulator.device.power_off()
    bench.run(100)
    assert len(bench.take()) == 9 + 16
    bench.emulator.device.power_on()
    bench.run(600)
    assert bench.take() == b""


@pytest.mark.parametrize("reception", ["line", "callback"])
def test_a_power_cycle_within_a_command_voids_it(reception):
    """Also where the unit listens again before its next octet comes."""
    bench = make(unit(autonomous=False, reception=reception, timing={"boot_ms": 0})).boot()
    bench.put(HOUSEKEEPING)
    bench.run(LINE_9_MS / 2)
    bench.emulator.device.power_off()
    bench.emulator.device.power_on()
    bench.run(50)
    assert bench.take() == b""
    assert bench.count() == 1


def test_a_warm_reset_keeps_the_counter():
    bench = idle()
    assert [bench.count(), bench.count()] == [1, 3]
    execute(bench, Reset(ResetCause.WARM_RESET))
    bench.run(600)
    assert bench.count() == 5


def test_after_a_shutdown_it_is_silent():
    bench = idle()
    execute(bench, Shutdown())
    bench.run(10)
    bench.put(HOUSEKEEPING)
    bench.run(1000)
    assert bench.take() == b""


def test_in_fault_nothing_is_valid_and_the_last_attitude_is_held():
    bench = make(unit(layout="readme"), scenario=sky()).boot()
    valid = bench.until_valid()
    bench.emulator.device.enter_fault(FaultCause.SENSOR_LOST)
    fault = bench.data()
    assert fault["valid"] == 0
    assert [fault[f"q{n}"] for n in range(4)] == [valid[f"q{n}"] for n in range(4)]
    reply = bench.ask("housekeeping")
    assert reply is not None
    assert reply["status"] == 1
    bench.emulator.device.power_off()
    bench.emulator.device.power_on()
    bench.run(420)
    reply = bench.ask("housekeeping")
    assert reply is not None
    assert reply["status"] == 0


def test_in_standby_nothing_is_valid():
    bench = make(unit(), scenario=sky()).boot()
    bench.until_valid()
    execute(bench, GoStandby())
    assert bench.data()["valid"] == 0
    execute(bench, Acquire())
    bench.until_valid()


def test_a_damaged_store_is_told():
    class DamagedStore(VolatileStore):
        def load(self) -> tuple[StoreContents, StoreInvalidCause | None]:
            return super().load()[0], next(iter(StoreInvalidCause))

    bench = make(unit(layout="readme", autonomous=False), store=DamagedStore()).boot()
    reply = bench.ask("housekeeping")
    assert reply is not None
    assert reply["status"] == 2


def test_what_the_device_tells_beside_is_not_sent():
    bench = idle()
    execute(bench, CaptureImage())
    bench.run(1000)
    assert bench.take() == b""


def test_it_has_no_can_bus():
    with pytest.raises(ConfigurationError, match="nos3 has no CAN bus"):
        Emulator(unit(), can=CanWiring())


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"layout": "book"}, "layout: found 'book'; allowed is one of 'code', 'readme'"),
        ({"reply_delay_us": -1}, "reply_delay_us: found -1; allowed is a whole number from 0 to 1000000"),
        ({"reply_delay_us": 1_000_001}, "reply_delay_us"),
        ({"counter": 2}, "counter"),
        ({"speed": 1}, "speed: is not a known key; allowed are layout, enabled"),
    ],
)
def test_wrong_settings_are_told(settings, said):
    with pytest.raises(ConfigurationError, match=r"dialects\.nos3: ") as error:
        Emulator(unit(**settings))
    assert said in str(error.value)


def test_where_and_counts():
    bench = idle()
    dialect = bench.emulator.dialect
    assert dialect.where() == "115200 baud, layout code"
    bench.put(HOUSEKEEPING + client.raw_command(77) + b"\xde\xad\x00\x00\x00\x00\x00\x00\x00")
    bench.run(20)
    assert dialect.messages_received == 3  # good, unknown, malformed
    assert dialect.messages_sent == 2


def test_the_link_is_work_for_the_processor():
    bench = idle()
    dialect = bench.emulator.dialect
    dialect.take_work()
    bench.put(b"\x00" + HOUSEKEEPING)
    bench.run(5)
    work = dialect.take_work()
    assert work.counts == {
        "telemetry_bytes": 17, "telecommand_bytes": 10, "telecommands": 1,
        "sending_rounds": 1, "receiving_rounds": 1,
    }  # fmt: skip
    assert not any(dialect.take_work().counts.values())
