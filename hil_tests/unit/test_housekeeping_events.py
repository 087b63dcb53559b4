"""Housekeeping at its intervals to the nanosecond, events on and off, memories."""

import pytest

from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.received import EVENT

from .conftest import MS, Bench, MakeBench


def sent_ns(bench: Bench, structure: int) -> list[int]:
    """On-board time stamps (from power-on) of the periodic reports of a structure, in ms."""
    stamps = []
    for packet in bench.packets:
        if packet.name == "hk_report" and packet.fields["structure_id"] == structure:
            coarse, fine = packet.decoded["time"]
            stamps.append(coarse * 10**9 + fine * 10**9 / 2**24)
    return stamps


def test_status_comes_by_itself_after_the_boot(new_bench: MakeBench) -> None:
    bench = new_bench()
    bench.run(3600)
    assert [round(at / MS, 3) for at in sent_ns(bench, 1)] == [1400, 2400, 3400]
    assert bench.of("hk_report")[0]["values"]["uptime_ms"] == 1400


def test_a_unit_may_start_without_it(new_bench: MakeBench) -> None:
    bench = new_bench(wire={"status_interval_ms": 0})
    bench.run(3000)
    assert bench.of("hk_report") == []


def test_interval_from_enabling_on_to_the_tick(bench: Bench) -> None:
    bench.send("hk_set_interval", {"intervals": [{"structure_id": 2, "interval_ms": 333}]}, ack=0)
    bench.run(20)
    bench.forget()
    put = wire.slip_frame(bench.packet("hk_enable", {"structure_ids": [2]}, ack=1))
    enabled_ns = bench.emulator.now_ns + len(put) * 10**10 // 115200 + 500_000
    bench.put(put)
    bench.run(1100)
    assert len(sent_ns(bench, 2)) == 3
    for number, at in enumerate(sent_ns(bench, 2), start=1):
        assert at == pytest.approx(enabled_ns + number * 333 * MS, abs=120)
    # Enabling what is enabled changes nothing; setting the interval starts the count anew.
    bench.forget()
    bench.send("hk_enable", {"structure_ids": [2]}, ack=0)
    bench.run(300)
    assert sent_ns(bench, 2)[0] == pytest.approx(enabled_ns + 4 * 333 * MS, abs=120)
    bench.forget()
    put = wire.slip_frame(
        bench.packet("hk_set_interval", {"intervals": [{"structure_id": 2, "interval_ms": 250}]}, ack=0)
    )
    set_ns = bench.emulator.now_ns + len(put) * 10**10 // 115200 + 500_000
    bench.put(put)
    bench.run(600)
    assert sent_ns(bench, 2) == [pytest.approx(set_ns + n * 250 * MS, abs=120) for n in (1, 2)]


def test_disabled_means_silent_and_an_interval_alone_does_not_enable(bench: Bench) -> None:
    bench.send("hk_enable", {"structure_ids": [1, 2, 3]})
    bench.run(1100)
    assert {fields["structure_id"] for fields in bench.of("hk_report")} == {1, 2, 3}
    bench.send("hk_disable", {"structure_ids": [1, 2, 3]})
    bench.run(20)
    bench.forget()
    bench.send("hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 250}]}, ack=0)
    bench.run(3000)
    assert bench.packets == []


def test_one_shot_answers_in_the_order_asked(bench: Bench) -> None:
    bench.send("hk_one_shot", {"structure_ids": [3, 1, 3]})
    bench.run(60)
    assert [fields["structure_id"] for fields in bench.of("hk_report")] == [3, 1, 3]


def test_status_values(bench: Bench) -> None:
    asked_ms = bench.now_ms
    values = bench.housekeeping(1)
    assert values["mode"] == 2
    assert values["reset_cause"] == 0
    assert values["boot_count"] == 1
    assert asked_ms <= values["uptime_ms"] <= asked_ms + 20
    assert values["last_reasons"] == 0x20  # NOT_ACQUIRING
    assert values["stored_parameters_valid"] == 1
    assert values["frames_processed"] == 0
    assert values["last_frame_index"] == values["uptime_ms"] // 250


def test_frame_counters(bench: Bench) -> None:
    bench.to_mode("TRACKING")
    bench.run(2000)
    values = bench.housekeeping(1)
    reports = bench.of("attitude_report")
    assert values["frames_processed"] == len(reports)
    assert values["frames_valid"] == sum(fields["valid"] for fields in reports)
    assert (
        values["frames_tracking"] == sum(fields["valid"] and fields["mode"] == 4 for fields in reports) >= 6
    )
    assert values["frames_late"] == values["frames_dropped"] == 0
    assert values["last_reasons"] == 0


def test_link_counts_bytes_and_packets_and_clear_counters_clears_all(bench: Bench) -> None:
    line = b"".join(data for _, data in bench.groups)
    values = bench.housekeeping(2)
    assert values["tx_bytes"] == len(line)
    assert values["tx_packets"] == len(wire.slip_frames(line))
    assert values["tc_accepted"] == values["tc_received"] == 2
    bench.function("CLEAR_COUNTERS", ack=0)
    bench.run(20)
    request = wire.slip_frame(bench.packet("hk_one_shot", {"structure_ids": [2]}, ack=0))
    bench.put(request)
    bench.run(20)
    values = bench.of("hk_report")[-1]["values"]
    assert values["rx_bytes"] == len(request)
    assert values["tc_received"] == 1
    assert values["tc_accepted"] == 1
    assert values["tx_bytes"] == values["tx_packets"] == values["tc_rejected"] == 0


def test_structure_can_is_0_on_the_serial_line(bench: Bench) -> None:
    bench.send("ping")
    values = bench.housekeeping(4)
    assert values.pop("can_state") == 3, "NOT_USED"
    assert len(values) == 26
    assert set(values.values()) == {0}


def test_disabled_events_are_silent_and_listed(bench: Bench) -> None:
    bench.send("event_disable", {"event_ids": [EVENT["MODE_CHANGED"], EVENT["TIME_SET"]]}, ack=0)
    bench.send("event_report_disabled", ack=0)
    bench.function("START_ACQUISITION", ack=0)
    bench.run(100)
    assert bench.of("event_disabled_list") == [{"event_ids": [2, 12]}]
    assert bench.events("MODE_CHANGED") == []
    bench.send("event_enable", {"event_ids": [2, 3]}, ack=0)
    bench.send("event_report_disabled", ack=0)
    bench.function("GO_STANDBY", ack=0)
    bench.run(100)
    assert bench.of("event_disabled_list")[-1] == {"event_ids": [12]}
    assert len(bench.events("MODE_CHANGED")) == 1
    bench.function("RESET", {"kind": 0}, ack=0)
    bench.run(500)
    bench.send("event_report_disabled", ack=0)
    bench.run(30)
    assert bench.of("event_disabled_list")[-1] == {"event_ids": []}, "every event is enabled after a start"


def test_load_dump_and_check(bench: Bench) -> None:
    data = bytes(range(256))
    for start in (0, 65536 - 256):
        bench.send(
            "memory_load",
            {"memory_id": 1, "start_address": start, "data": data, "checksum": wire.crc16(data)},
        )
        bench.run(60)
        bench.send("memory_dump", {"memory_id": 1, "start_address": start, "length": 256})
        bench.send("memory_check", {"memory_id": 1, "start_address": start, "length": 256})
        bench.run(80)
        assert bench.of("memory_dump_report")[-1] == {
            "memory_id": 1,
            "start_address": start,
            "data": data,
            "checksum": wire.crc16(data),
        }
        assert bench.of("memory_check_report")[-1] == {
            "memory_id": 1,
            "start_address": start,
            "length": 256,
            "checksum": wire.crc16(data),
        }
    bench.send("memory_dump", {"memory_id": 1, "start_address": 250, "length": 20}, ack=0)
    bench.run(30)
    assert bench.of("memory_dump_report")[-1]["data"] == data[250:] + bytes(14)
    bench.function("RESET", {"kind": 1}, ack=0)
    bench.run(500)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 4}, ack=0)
    bench.run(30)
    assert bench.of("memory_dump_report")[-1]["data"] == bytes(4)


def test_non_volatile_memory_reads_as_the_stored_parameters(bench: Bench) -> None:
    bench.set_parameters(tracking_min_stars=5)
    text = b'{"tracking_min_stars": 5}'
    for start in (0, 1024):  # the memory has 2048 bytes, zero behind the text
        bench.send("memory_dump", {"memory_id": 2, "start_address": start, "length": 1024}, ack=0)
        bench.run(150)
    first, second = (report["data"] for report in bench.of("memory_dump_report"))
    assert first + second == text.ljust(2048, b"\0")
    count = bench.send("memory_dump", {"memory_id": 2, "start_address": 2047, "length": 2}, ack=0)
    bench.run(30)
    assert bench.failure(count)[1] == 14


def test_verification_finds_room_in_a_full_queue(bench: Bench) -> None:
    """Reports overflow the queue; each accepted telecommand still ends in exactly one completion."""
    wanted = {"structure_ids": [1, 2, 3, 1] * 4}
    packets = [bench.packet("hk_one_shot", wanted, ack=0b1001) for _ in range(150)]
    bench.put(b"".join(wire.slip_frame(packet) for packet in packets))
    bench.run(15_000)
    assert len(bench.of("acceptance_success")) == len(packets)
    assert len(bench.of("completion_success")) == len(packets)
    assert len(bench.of("hk_report")) < 16 * len(packets)


def test_queue_overflow_is_told_with_the_packets_lost(bench: Bench) -> None:
    dump = {"memory_id": 1, "start_address": 0, "length": 1024}
    bench.send("ping")
    bench.put(b"".join(wire.slip_frame(bench.packet("memory_dump", dump, ack=0)) for _ in range(60)))
    bench.run(8000)
    reports = len(bench.of("memory_dump_report"))
    assert 28 <= reports < 60
    bench.send("ping")
    bench.run(1000)
    assert len(bench.of("pong")) == 2
    told = [event["packets"] for event in bench.events("TX_QUEUE_OVERFLOWED")]
    assert told
    assert sum(told) == missing_counts(bench) >= 60 - reports
    bench.send("ping")
    bench.run(1000)
    assert len(bench.events("TX_QUEUE_OVERFLOWED")) == len(told)


def missing_counts(bench: Bench) -> int:
    """Packets that the sequence count shows as missing between the first and the last."""
    counts = [packet.decoded["sequence_count"] for packet in bench.packets]
    return (counts[-1] - counts[0] + 1) % 16384 - len(counts)
