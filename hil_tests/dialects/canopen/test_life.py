"""Boot and its time, network management, heartbeat, resets, power."""

from __future__ import annotations

from itertools import pairwise

import pytest

from hil_tests.dialects.canopen.bench import MS, make
from hil_tests.dialects.canopen.client import DEVICE_STATE, NMT, STATES, AbortedError
from st_emulator.device.store import StoreContents, VolatileStore
from st_emulator.errors import ConfigurationError
from st_emulator.wire.can.wiring import CanWiring


@pytest.mark.parametrize("name", ["roja1", "zy3"])
def test_nothing_is_said_before_the_boot_up_message(name):
    bench = make(name)
    boot_ms = bench.emulator.profile.timing.boot_ms
    bench.put(0x600 + bench.node, bytes.fromhex("4000400000000000"))
    bench.run(boot_ms - 1)
    assert bench.sent == []
    bench.run(3)
    ((t_ns, identifier, data),) = bench.sent
    assert (identifier, data) == (0x72C, b"\0")
    assert boot_ms * MS < t_ns < boot_ms * MS + 100_000  # the frame's own bits


def test_heartbeats_at_their_period():
    bench = make().boot()
    bench.run(3100)
    times = [t_ns for t_ns, _ in bench.heartbeats]
    assert [data for _, data in bench.heartbeats] == [b"\x05"] * 3
    assert {b - a for a, b in pairwise(times)} == {1000 * MS}


def test_another_heartbeat_time_holds_at_once():
    bench = make().boot()
    bench.sdo.write(0x1017, 0, (50).to_bytes(2, "little"))
    bench.forget()
    bench.run(230)
    assert len(bench.heartbeats) == 4
    bench.sdo.write(0x1017, 0, bytes(2))
    bench.forget()
    bench.run(3000)
    assert bench.heartbeats == []


def test_a_node_that_waits_to_be_started():
    bench = make(goes_operational=False, heartbeat_ms=100).boot()
    bench.run(105)
    assert bench.heartbeats[-1][1] == b"\x7f"
    assert bench.state == STATES["STANDBY"]  # SDO is spoken
    bench.ask_for("STAR_TRACK")
    bench.run(1200)
    assert bench.attitudes == []  # PDOs are not
    bench.nmt("start")
    bench.run(700)
    assert bench.heartbeats[-1][1] == b"\x05"
    assert len(bench.attitudes) >= 2


def test_a_stopped_node_speaks_its_heartbeat_alone():
    bench = make(heartbeat_ms=100).boot()
    bench.nmt("stop")
    bench.forget()
    assert bench.exchange(bytes.fromhex("4000400000000000")) == []
    bench.run(250)
    assert {identifier for _, identifier, _ in bench.sent} == {0x72C}
    assert bench.heartbeats[-1][1] == b"\x04"
    bench.nmt("pre_operational")
    bench.run(120)
    assert bench.heartbeats[-1][1] == b"\x7f"
    assert bench.state == STATES["STANDBY"]


def test_commands_to_others_and_broken_ones_are_ignored():
    bench = make(heartbeat_ms=100).boot()
    bench.nmt("stop", node=3)
    for data in (b"", b"\x02", b"\x02\x2c\x00", b"\x07\x2c", b"\x00\x00"):
        bench.put(0, data)
    bench.run(220)
    assert bench.heartbeats[-1][1] == b"\x05"
    bench.nmt("stop", node=0)  # every node
    bench.run(120)
    assert bench.heartbeats[-1][1] == b"\x04"


def test_reset_of_the_communication_keeps_the_device():
    bench = make().boot()
    bench.sdo.write(0x1017, 0, (50).to_bytes(2, "little"))
    bench.sdo.write(0x4001, 2, (777).to_bytes(4, "little"))
    bench.ask_for("STAR_TRACK")
    bench.forget()
    bench.nmt("reset_communication")
    assert bench.heartbeats[0][1] == b"\0"
    assert bench.sdo.number(0x1017) == 1000
    assert bench.sdo.number(0x4001, 2) == 777
    assert bench.state == STATES["STAR_TRACK"]


@pytest.mark.parametrize("way", ["nmt", "soft", "hard", "factory"])
def test_resets_of_the_node(way):
    bench = make(parameters={"tracking_min_stars": 5}).boot()
    bench.set_time()
    bench.sdo.write(0x4001, 2, (777).to_bytes(4, "little"))
    bench.ask_for("STAR_TRACK")
    bench.run(600)
    starts = bench.sdo.number(0x3003, 6)
    bench.forget()
    sent_ns = bench.emulator.now_ns
    if way == "nmt":
        bench.put(0, bytes((NMT["reset_node"], bench.node)))
    else:
        bench.sdo.write(0x3003, 1, bytes((("", "soft", "hard", "factory").index(way),)))
    bench.run_until(lambda: bench.heartbeats and bench.heartbeats[-1][1] == b"\0")
    boot_ms = bench.emulator.profile.timing.boot_ms
    assert 0 <= bench.heartbeats[-1][0] - sent_ns - boot_ms * MS < 2 * MS
    assert bench.state == STATES["STANDBY"]
    assert bench.sdo.number(0x4001, 2) == 100
    assert bench.sdo.number(0x3003, 6) == starts + 1
    kept = way == "soft"
    assert (bench.sdo.number(0x3003, 4) > 1_700_000_000) is kept  # the time survives a soft reset
    least_stars = bench.emulator.device.parameters["tracking_min_stars"]
    assert (least_stars == 5) is (way != "factory")


def test_power_off_by_command_and_on_again():
    bench = make().boot()
    bench.sdo.write(0x3003, 1, b"\x04")
    bench.run(20)
    bench.forget()
    bench.run(3000)
    assert bench.sent == []
    assert bench.exchange(bytes.fromhex("4000400000000000")) == []
    bench.emulator.device.power_off()
    bench.emulator.device.power_on()
    bench.run(bench.emulator.profile.timing.boot_ms + 2)
    assert bench.heartbeats[0][1] == b"\0"
    assert bench.state == STATES["STANDBY"]


def test_a_power_cycle_at_any_instant():
    bench = make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run(700)
    bench.put(0x62C, bytes.fromhex("a408100064000000"))
    bench.emulator.device.power_off()
    bench.forget()
    bench.run(1500)
    assert bench.sent == []
    bench.emulator.device.power_on()
    bench.run(bench.emulator.profile.timing.boot_ms + 2)
    assert [data for _, data in bench.heartbeats] == [b"\0"]
    assert bench.state == STATES["STANDBY"]
    assert bench.sdo.number(0x4002, 6) == 0  # no attitude is known


def test_a_long_boot():
    bench = make(boot_ms=1500).boot()
    assert bench.state == STATES["BOOT"]
    bench.ask_for("STAR_TRACK")  # acknowledged and ignored
    bench.run_until(lambda: bench.now_ms > 1480)
    assert bench.state == STATES["BOOT"]
    bench.run_until(lambda: bench.now_ms > 1501)
    assert bench.state == STATES["STANDBY"]


def test_a_unit_that_starts_by_itself():
    bench = make(parameters={"autonomous_start": 1}).boot()
    bench.run(1000)
    assert bench.state == STATES["STAR_TRACK"]
    assert len(bench.attitudes) >= 2


def test_node_numbers():
    bench = make(node=5, obc_node=9).boot()
    assert bench.state == STATES["STANDBY"]
    assert bench.sdo.number(0x1400, 1) == 0x189
    bench = make(can=CanWiring(node=7), node=5).boot()
    assert bench.node == 7
    assert bench.sdo.number(0x1804, 1) == 0x188
    assert "node 7" in bench.emulator.dialect.where()


def test_wires_that_it_does_not_have():
    with pytest.raises(ConfigurationError, match="classic CAN"):
        make(can=CanWiring(fd=True))
    with pytest.raises(ConfigurationError, match="no serial line"):
        make(can=None)


def test_a_reset_that_the_bus_does_not_let_out():
    bench = make(heartbeat_ms=20).boot()
    starts = bench.emulator.device.parameters.boot_count
    bench.refusing = True
    bench.run(100)  # a heartbeat waits
    bench.put(0, bytes((NMT["reset_node"], bench.node)))
    bench.run(990)
    assert bench.emulator.device.parameters.boot_count == starts
    bench.run(20)
    assert bench.emulator.device.parameters.boot_count == starts + 1  # a second behind the command
    bench.refusing = False
    bench.forget()
    bench.run(500)
    assert bench.heartbeats[0][1] == b"\0"


def test_factory_values_are_refused_in_error_and_nothing_has_changed():
    bench = make().boot()
    bench.ask_for("STAR_TRACK")
    bench.ask_for("ERROR")
    with pytest.raises(AbortedError) as error:
        bench.sdo.write(0x3003, 1, b"\x03")
    assert error.value.code == DEVICE_STATE
    assert bench.state == STATES["ERROR"]


def test_the_stores_fault_is_told():
    class Damaged(VolatileStore):
        def load(self):
            from st_emulator.firmware_model.causes import StoreInvalidCause

            return super().load()[0], StoreInvalidCause.BAD_CHECKSUM

    bench = make(store=Damaged(StoreContents({}, 0)))
    bench.run(450)
    # 6300h; register 01: generic; 83h: the store's cause 3 (BAD_CHECKSUM).
    assert bench.emergencies == [bytes.fromhex("0063 01 83 00000000")]
    assert bench.sdo.number(0x1001) == 1
