"""When TPDOs go out by event, SYNC and timer; what an RPDO does; SYNC and emergency messages."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest

from hil_tests.dialects.canopen import client
from hil_tests.dialects.canopen.bench import MS, START_UNIX_S, make
from hil_tests.dialects.canopen.client import READ_ONLY, VALUE, AbortedError
from st_emulator.protocol.can.bits import frame_duration_ns
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.wire.can.wiring import CanWiring

TPDO_1, TPDO_2, TPDO_3 = 0x1AC, 0x2AC, 0x3AC


def times_ms(found: list[tuple[int, bytes]]) -> list[float]:
    return [t_ns / MS for t_ns, _ in found]


def test_timers_of_the_housekeeping():
    bench = make()
    bench.run(61_000)
    boot_ms = bench.emulator.profile.timing.boot_ms
    assert times_ms(bench.of(TPDO_1)) == pytest.approx([boot_ms + 30_000, boot_ms + 60_000], abs=0.3)
    assert times_ms(bench.of(TPDO_2)) == pytest.approx([boot_ms + 5000 * n for n in range(1, 13)], abs=0.3)
    assert bench.of(TPDO_1)[0][1] == bytes(6)
    assert bench.of(TPDO_2)[0][1] == bytes(2)


def test_an_event_timer_that_is_written():
    bench = make().boot()
    bench.sdo.write(0x1801, 5, (40).to_bytes(2, "little"))
    bench.forget()
    bench.run(205)
    assert len(bench.of(TPDO_2)) == 5
    bench.sdo.write(0x1801, 5, bytes(2))
    bench.forget()
    bench.run(300)
    assert bench.of(TPDO_2) == []


def test_the_parameters_are_constants_as_on_the_card():
    bench = make().boot()
    for sub, size in ((1, 4), (2, 1), (3, 2)):
        with pytest.raises(AbortedError) as error:
            bench.sdo.write(0x1802, sub, bytes(size))
        assert error.value.code == READ_ONLY


def test_each_nth_sync():
    bench = make(fixed_pdo_parameters=False).boot()
    bench.sdo.write(0x1801, 2, b"\x03")
    bench.sdo.write(0x1800, 2, b"\x01")
    bench.forget()
    for _ in range(7):
        bench.put(0x80)
        bench.run(10)
    assert len(bench.of(TPDO_1)) == 7
    assert len(bench.of(TPDO_2)) == 2
    bench.run(6000)
    assert len(bench.of(TPDO_2)) == 2  # no timer where SYNC decides


def test_at_the_sync_behind_an_event():
    bench = make(fixed_pdo_parameters=False).boot()
    bench.sdo.write(0x1802, 2, b"\0")
    bench.forget()
    bench.put(0x80)
    bench.run(5)
    assert bench.of(TPDO_3) == []
    bench.ask_for("STAR_TRACK")
    bench.run_until(lambda: bench.of(0x1AD))
    assert bench.of(TPDO_3) == []
    bench.put(0x80)
    bench.run(5)
    assert len(bench.of(TPDO_3)) == 1
    bench.put(0x80)
    bench.run(5)
    assert len(bench.of(TPDO_3)) == 1  # nothing new


def test_an_inhibit_time_holds_events_back():
    bench = make(fixed_pdo_parameters=False).boot()
    bench.sdo.write(0x1802, 3, (6000).to_bytes(2, "little"))  # 600 ms
    bench.ask_for("STAR_TRACK")
    bench.run(4000)
    times = times_ms(bench.of(TPDO_3))
    gaps = [b - a for a, b in pairwise(times)]
    assert len(times) >= 5
    assert min(gaps) >= 599.9
    # An image came meanwhile: the next goes out when the time is over, not with the next image.
    assert gaps[0] == pytest.approx(600, abs=0.5)
    assert len(bench.of(0x4AC)) > len(times)  # the others are not held back


def test_a_pdo_that_is_not_valid():
    bench = make(fixed_pdo_parameters=False).boot()
    bench.sdo.write(0x1801, 1, struct.pack("<I", 0x800002AC))
    bench.forget()
    bench.run(11_000)
    assert bench.of(TPDO_2) == []
    bench.sdo.write(0x1801, 1, struct.pack("<I", 0x3F0))
    bench.run(11_000)
    assert len(bench.of(0x3F0)) >= 2


@pytest.mark.parametrize("kind", [241, 251, 252, 253])
def test_transmission_types_that_are_none_or_need_remote_frames(kind):
    bench = make(fixed_pdo_parameters=False).boot()
    with pytest.raises(AbortedError) as error:
        bench.sdo.write(0x1801, 2, bytes((kind,)))
    assert error.value.code == VALUE


def test_no_pdos_before_operational():
    bench = make().boot()
    bench.nmt("pre_operational")
    bench.run(6000)
    assert bench.of(TPDO_2) == []
    bench.put(0x181, client.scet(1_900_000_000))
    bench.run(300)
    assert bench.sdo.number(0x3003, 4) < 100
    bench.nmt("start")
    start_ms = bench.now_ms
    bench.run(5100)
    assert times_ms(bench.of(TPDO_2)) == pytest.approx([start_ms + 5000], abs=3)


# -- RPDO 1 and the time


def test_the_time_is_that_of_the_frames_last_bit():
    bench = make(whole_seconds_since_midnight=False).boot()
    bench.run(97)
    put_ns = bench.emulator.now_ns
    bench.put(0x181, client.scet(START_UNIX_S, 250_000))
    bench.run(600)
    asked_ns = bench.emulator.now_ns
    value = bench.sdo.number(0x2010)
    seconds, microseconds = value & 0xFFFFFFFF, value >> 32 & 0xFFFFFF
    told_us = (seconds - START_UNIX_S) * 1_000_000 + microseconds - 250_000
    passed_us = (asked_ns - put_ns) / 1000
    # Both frames have 8 octets and took about the same; the answer is made behind the latency of 500 us.
    assert told_us - passed_us == pytest.approx(500, abs=30)


@pytest.mark.parametrize("way", ["RPDO", "SDO"])
def test_the_time_to_the_microsecond(way):
    """On a slow bus, where a frame takes 12 ms and its intermission 300 us."""
    bench = make(can=CanWiring(bitrate=10_000)).boot()
    bench.run(50)  # the boot-up message has left
    latency_ns = bench.emulator.profile.timing.telecommand_latency_us * 1000
    value = client.scet(START_UNIX_S, 250_000)

    def put(identifier: int, data: bytes) -> int:
        """When its last bit is over."""
        start_ns = bench.emulator.now_ns
        bench.put(identifier, data)
        bench.run(40)
        frame = CanFrame(identifier, data)
        return start_ns + frame_duration_ns(frame, 10_000, 10_000) - 3 * 100_000

    if way == "RPDO":
        set_ns = put(0x181, value)
    else:
        put(0x62C, b"\x21" + client.place(0x2010, 0) + bytes((8, 0, 0, 0)))
        put(0x62C, b"\x00" + value[:7])
        set_ns = put(0x62C, b"\x1d" + value[7:] + bytes(6))
    bench.run(300)
    asked_ns = put(0x62C, b"\x40" + client.place(0x2010, 0) + bytes(4))
    bench.forget()
    put(0x62C, b"\x60" + bytes(7))
    ((_, answer),) = bench.of(0x5AC)[:1]
    seconds, microseconds = struct.unpack("<I", answer[1:5])[0], int.from_bytes(answer[5:8], "little")
    told_us = (seconds - START_UNIX_S) * 1_000_000 + microseconds - 250_000
    # The object is read when the request is processed: the intermission and the latency behind its last bit.
    assert told_us == pytest.approx((asked_ns + 300_000 + latency_ns - set_ns) / 1000, abs=1.5)


def test_a_setting_is_in_force_with_the_next_frame():
    bench = make().boot()
    bench.put(0x181, client.scet(START_UNIX_S))
    bench.run(3)
    assert bench.sdo.number(0x3003, 4) < 100
    bench.run(250)
    assert bench.sdo.number(0x3003, 4) == START_UNIX_S


def test_time_by_sdo_in_both_codes():
    bench = make().boot()
    bench.sdo.write(0x2010, 0, client.scet(1_000_000_000, 999_999))
    bench.run(260)
    assert bench.sdo.number(0x3003, 4) == 1_000_000_001
    bench.sdo.write(0x2011, 0, client.utc(20468, 43_200_000, 7))
    bench.run(260)
    assert bench.sdo.number(0x3003, 4) == 20468 * 86400 + 43_200
    days, ms, us = struct.unpack("<HIH", bench.sdo.read(0x2011))
    assert days == 20468
    assert 43_200_000 < ms < 43_200_300
    assert us < 1000
    for index, data in ((0x2010, client.scet(5, 1_000_000)), (0x2011, client.utc(5, 86_400_000))):
        with pytest.raises(AbortedError) as error:
            bench.sdo.write(index, 0, data)
        assert error.value.code == VALUE


@pytest.mark.parametrize("seconds", [0, 63_072_000, 4_294_967_295])
def test_times_at_the_ends(seconds):
    bench = make().boot()
    bench.put(0x181, client.scet(seconds))
    bench.run(260)
    if seconds < 4_000_000_000:
        assert bench.sdo.number(0x3003, 4) in (seconds, seconds + 1)
    else:  # behind 2094 the device's own 32 bits of seconds since 1958 turn over
        bench.sdo.number(0x3003, 4)
        bench.sdo.read(0x2010)
        bench.sdo.read(0x2011)


def test_a_short_rpdo_is_told_and_not_processed():
    bench = make().boot()
    bench.put(0x181, client.scet(START_UNIX_S)[:7])
    bench.run(260)
    # 8210h; register 11h: communication and generic; RPDO 1, 7 octets.
    assert bench.emergencies == [bytes.fromhex("1082 11 01 07 000000")]
    assert bench.sdo.number(0x3003, 4) < 100
    assert bench.sdo.number(0x1001) == 0  # of the moment
    assert bench.sdo.number(0x1003, 0) == 1
    assert bench.sdo.number(0x1003, 1) == 0x0701_8210


def test_a_synchronous_rpdo_waits_for_the_sync():
    bench = make(fixed_pdo_parameters=False).boot()
    bench.sdo.write(0x1400, 2, b"\x01")
    bench.put(0x181, client.scet(START_UNIX_S))
    bench.run(600)
    assert bench.sdo.number(0x3003, 4) < 100
    bench.put(0x80)
    bench.run(260)
    # in force late, but true: it counts from the frame
    assert START_UNIX_S <= bench.sdo.number(0x3003, 4) <= START_UNIX_S + 1


# -- SYNC and emergency objects


def test_another_identifier_of_sync_and_its_counter():
    bench = make(fixed_pdo_parameters=False).boot()
    bench.sdo.write(0x1801, 2, b"\x01")
    bench.sdo.write(0x1005, 0, struct.pack("<I", 0x90))
    bench.sdo.write(0x1019, 0, b"\x0a")
    bench.forget()
    bench.put(0x80)
    bench.put(0x90, b"\x01")
    bench.run(5)
    assert len(bench.of(TPDO_2)) == 1
    bench.put(0x90)
    bench.run(5)
    assert len(bench.of(TPDO_2)) == 1
    assert bench.emergencies == [bytes.fromhex("4082 11 00 00000000")]
    for index, data in ((0x1005, struct.pack("<I", 1 << 30 | 0x80)), (0x1019, b"\x01"), (0x1019, b"\xf1")):
        with pytest.raises(AbortedError) as error:
            bench.sdo.write(index, 0, data)
        assert error.value.code == VALUE


def short_rpdo(bench, length: int) -> None:
    bench.put(0x181, bytes(length))
    bench.run(2)


def test_the_history_keeps_eight_and_is_emptied():
    bench = make().boot()
    with pytest.raises(AbortedError) as error:
        bench.sdo.read(0x1003, 1)
    assert error.value.code == client.NO_DATA
    for length in (0, 1, 2, 3, 4, 5, 6, 7, 0, 1):
        short_rpdo(bench, length)
    assert bench.sdo.number(0x1003, 0) == 8
    past = [bench.sdo.number(0x1003, sub) >> 24 for sub in range(1, 9)]
    assert past == [1, 0, 7, 6, 5, 4, 3, 2]  # the newest first
    with pytest.raises(AbortedError) as error:
        bench.sdo.write(0x1003, 0, b"\x01")
    assert error.value.code == VALUE
    bench.sdo.write(0x1003, 0, b"\0")
    assert bench.sdo.number(0x1003, 0) == 0


def test_the_inhibit_time_of_emergencies():
    bench = make().boot()
    bench.sdo.write(0x1015, 0, (500).to_bytes(2, "little"))  # 50 ms
    for length in range(3):
        short_rpdo(bench, length)
    assert len(bench.emergencies) == 1
    bench.run(200)
    times = times_ms(bench.of(0xAC))
    assert [b - a for a, b in pairwise(times)] == pytest.approx([50, 50], abs=0.1)


def test_emergencies_elsewhere_or_not_at_all():
    bench = make().boot()
    with pytest.raises(AbortedError):
        bench.sdo.write(0x1014, 0, struct.pack("<I", 0xB0))  # it is switched on
    bench.sdo.write(0x1014, 0, struct.pack("<I", 0x800000AC))
    short_rpdo(bench, 1)
    assert bench.emergencies == []
    bench.sdo.write(0x1014, 0, struct.pack("<I", 0xB0))
    short_rpdo(bench, 1)
    assert len(bench.of(0xB0)) == 1


def test_emergencies_of_a_stopped_node_wait():
    from st_emulator.firmware_model.causes import FaultCause

    bench = make().boot()
    bench.nmt("stop")
    bench.emulator.device.enter_fault(FaultCause.SENSOR_LOST)
    bench.run(50)
    assert bench.emergencies == []
    bench.nmt("pre_operational")
    bench.run(5)
    # 5000h; 01; the cause of the fault: 2.
    assert bench.emergencies == [bytes.fromhex("0050 01 02 00000000")]


FAULTS = {1: "0050", 2: "0050", 3: "0010", 4: "0063", 5: "0010", 6: "0061"}


@pytest.mark.parametrize("cause", FAULTS)
def test_each_fault_of_the_device(cause):
    from st_emulator.firmware_model.causes import FaultCause

    bench = make().boot()
    bench.emulator.device.enter_fault(FaultCause(cause))
    bench.run(5)
    assert bench.emergencies == [bytes.fromhex(FAULTS[cause]) + bytes((1, cause, 0, 0, 0, 0))]
    assert bench.state == client.STATES["ERROR"]
