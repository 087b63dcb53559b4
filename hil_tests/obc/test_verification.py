"""Which report came for which telecommand, and what is said of those that did not."""

import struct
from typing import Any

import pytest

from st_emulator.obc import (
    LocalProtocolError,
    Obc,
    ObcProtocol,
    State,
    TelecommandTimeout,
    VerificationError,
)

FUNCTION = (8, 1)


def test_every_stage_of_a_long_telecommand_with_its_time(obc: Obc, unit: Any) -> None:
    def handle(request: Any) -> None:
        unit.report(request, 1)
        unit.report(request, 3, after_ms=10)
        unit.report(request, 5, b"\x01", after_ms=20)
        unit.report(request, 5, b"\x02", after_ms=30)
        unit.report(request, 7, after_ms=40)

    unit.handlers[FUNCTION] = handle
    verification = obc.send("function", function_id="START_SELF_TEST")
    assert verification.state is State.VERIFIED
    assert (verification.accepted, verification.started, verification.completed) == (True, True, True)
    assert verification.steps == [1, 2]
    sent_ns = verification.sent_ns
    assert verification.accepted_ns == sent_ns + 1_000_000  # the unit reads at its next step
    assert verification.started_ns == sent_ns + 11_000_000
    assert verification.completed_ns == sent_ns + 41_000_000
    assert verification.seconds == pytest.approx(0.041)
    assert verification.missing == ()
    assert obc.counters.telecommands_verified == obc.counters.telecommands_sent == 1


def test_the_telecommand_on_the_wire(obc: Obc, unit: Any, wire: Any) -> None:
    unit.answer(FUNCTION)
    obc.send("function", function_id="reset", kind="cold")
    (request,) = unit.requests
    assert (
        request.packet.hex()
        == (
            "1923"  # version 0, telecommand, secondary header, APID 0x123
            "c000"  # unsegmented, count 0
            "0008"  # 9 bytes of packet data - 1
            "28"  # PUS version 2, acceptance only: nothing else is sure to leave before a reset
            "0801"  # TC[8,1]
            "002a"  # source 42
            "0401"  # function 4, cold
            + struct.pack(">H", wire.crc16(request.packet[:-2])).hex()
        )
    )


def test_acknowledgement_flags_are_the_callers(obc: Obc, unit: Any) -> None:
    unit.handlers[(17, 1)] = lambda request: (unit.report(request, 1), unit.send(17, 2))
    verification = obc.send("ping", ack=0b1000)
    assert unit.requests[0].ack == 0b1000
    assert verification.completed is None
    assert verification.state is State.VERIFIED


def test_without_acknowledgement_nothing_is_waited_for(obc: Obc) -> None:
    before_ns = obc.now_ns()
    assert obc.send("ping", ack=0).state is State.VERIFIED
    assert obc.now_ns() == before_ns
    assert obc.counters.telecommands_verified == 1


def test_a_failure_of_an_unacknowledged_telecommand_is_still_its_own(obc: Obc, unit: Any) -> None:
    unit.handlers[(17, 1)] = lambda request: unit.fail(request, 2, 7, 5)
    verification = obc.send("ping", ack=0)
    obc.wait(0.01)
    assert verification.state is State.FAILED
    assert verification.failure_name == "NOT_ALLOWED_IN_MODE"
    assert (obc.counters.telecommands_verified, obc.counters.telecommands_failed) == (0, 1)


@pytest.mark.parametrize(
    ("subservice", "stage", "accepted", "started", "completed"),
    [
        (2, "acceptance", False, None, None),
        (4, "start", True, False, None),
        (8, "completion", True, True, False),
        (10, "routing", False, None, None),
    ],
)
def test_a_failure_names_stage_code_and_data(
    obc: Obc, unit: Any, subservice: int, stage: str, accepted: bool, started: bool, completed: bool
) -> None:
    def handle(request: Any) -> None:
        if accepted:
            unit.report(request, 1)
        if started:
            unit.report(request, 3)
        unit.fail(request, subservice, 8, 12)

    unit.handlers[FUNCTION] = handle
    with pytest.raises(VerificationError) as error:
        obc.send("function", function_id="START_ACQUISITION")
    verification = error.value.verification
    assert verification.state is State.FAILED
    assert (verification.accepted, verification.started, verification.completed) == (
        accepted,
        started,
        completed,
    )
    assert error.value.failure_code == 8
    assert error.value.failure_name == "OUT_OF_RANGE"
    assert str(error.value).startswith(
        "function START_ACQUISITION TC[8,1] (APID 0x123, count 0): "
        f"{stage} failed: OUT_OF_RANGE (8), data 12 ("
    )
    assert verification.seconds == pytest.approx(0.001)
    assert obc.counters.telecommands_failed == 1


def test_an_unknown_failure_code_is_told_as_a_number(obc: Obc, unit: Any) -> None:
    unit.handlers[FUNCTION] = lambda request: unit.fail(request, 2, 999)
    with pytest.raises(VerificationError, match=r"CODE_999 \(999\), data 0 \(not a code of this interface"):
        obc.send("function", function_id="GO_STANDBY")


@pytest.mark.parametrize(
    ("sent", "missing"),
    [
        ((), ("acceptance report", "start report", "completion report")),
        ((1,), ("start report", "completion report")),
        ((1, 3), ("completion report",)),
        ((3,), ("acceptance report", "completion report")),
        ((7,), ("acceptance report",)),  # executed at once: completion stands for start
    ],
)
def test_a_timeout_names_what_never_came(
    obc: Obc, unit: Any, sent: tuple[int, ...], missing: tuple[str, ...]
) -> None:
    unit.handlers[FUNCTION] = lambda request: [unit.report(request, subservice) for subservice in sent]
    before_ns = obc.now_ns()
    with pytest.raises(TelecommandTimeout) as error:
        obc.send("function", function_id="START_ACQUISITION", timeout_s=0.25)
    assert error.value.missing == missing
    assert str(error.value).endswith(f"within 0.25 s never came: {', '.join(missing)}")
    assert obc.now_ns() - before_ns == 250_000_000
    assert obc.counters.telecommands_timed_out == 1


def test_a_report_that_comes_after_the_timeout_is_nobodys(obc: Obc, unit: Any) -> None:
    unit.handlers[(17, 1)] = lambda request: unit.report(request, 1, after_ms=300)
    with pytest.raises(TelecommandTimeout):
        obc.send("ping", timeout_s=0.1)
    obc.wait(0.5)
    assert obc.counters.unmatched_verifications == 1


def test_reports_of_another_sources_telecommand_change_nothing(obc: Obc, unit: Any, wire: Any) -> None:
    def handle(request: Any) -> None:
        foreign = struct.pack(">HH", 0x1800 | wire.APID, 0xC000 | 9)
        unit.send(1, 8, foreign + struct.pack(">HI", 7, 0))
        unit.complete(request)

    unit.handlers[(17, 1)] = handle
    assert obc.send("ping").state is State.VERIFIED
    assert obc.counters.unmatched_verifications == 1


def test_two_at_once_end_in_any_order(obc: Obc, unit: Any) -> None:
    held: list[Any] = []
    unit.handlers[FUNCTION] = held.append
    unit.answer((17, 1))
    long = obc.begin("function", function_id="CAPTURE_IMAGE")
    short = obc.send("ping")
    assert short.state is State.VERIFIED
    assert long.state is State.PENDING
    unit.complete(held[0])
    assert obc.finish(long) is long
    assert long.state is State.VERIFIED


def test_a_failed_step_does_not_end_the_execution(obc: Obc, unit: Any) -> None:
    def handle(request: Any) -> None:
        unit.report(request, 1)
        unit.report(request, 6, struct.pack(">BHI", 2, 11, 0))
        unit.report(request, 7)

    unit.handlers[FUNCTION] = handle
    verification = obc.send("function", function_id="DOWNLOAD_IMAGE", transaction_id=1, first_part=0, parts=0)
    assert verification.failed_steps == [(2, 11)]
    assert verification.state is State.VERIFIED


def test_sequence_counts_go_up_by_destination_and_wrap() -> None:
    protocol = ObcProtocol(apid=0x10)
    counts = []
    for _ in range(16_386):
        _, verification = protocol.telecommand("ping", {}, 0, ack=0, timeout_ns=0)
        counts.append(verification.request_id.sequence_count)
        protocol.expire(0)
    assert counts == [*range(16_384), 0, 1]
    assert len(protocol.verifications) == 0
    _, elsewhere = protocol.telecommand("ping", {}, 0, apid=0x11)
    assert (elsewhere.request_id.apid, elsewhere.request_id.sequence_count) == (0x11, 0)


@pytest.mark.parametrize(
    ("name", "fields", "message"),
    [
        ("no_such", {}, "no_such"),
        ("function", {"function_id": "DANCE"}, "DANCE"),
        ("parameter_set", {"settings": [{"parameter_id": "exposure_us", "value": 5}]}, "100..250000"),
        ("parameter_set", {"settings": [{"parameter_id": "exposure", "value": 5}]}, "'exposure'"),
        ("hk_one_shot", {"structures": [1]}, "structure"),
    ],
)
def test_what_cannot_be_sent_uses_up_no_sequence_count(
    obc: Obc, unit: Any, name: str, fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(LocalProtocolError, match=message):
        obc.send(name, **fields)
    assert obc.counters.telecommands_sent == 0
    unit.answer((17, 1))
    obc.send("ping")
    assert unit.requests[0].count == 0


def test_a_refusal_can_be_provoked(obc: Obc, unit: Any) -> None:
    unit.handlers[(20, 3)] = lambda request: unit.fail(request, 2, 8, 1)
    with pytest.raises(VerificationError, match="OUT_OF_RANGE"):
        obc.set_parameter("exposure_us", 5, strict=False)
    assert unit.requests[0].data == struct.pack(">BHI", 1, 1, 5)


def test_an_answer_that_never_comes_is_named(obc: Obc, unit: Any) -> None:
    unit.answer((17, 1))
    with pytest.raises(TelecommandTimeout, match=r"ping TC\[17,1\] .*within 1 s never came: pong"):
        obc.ping()


def test_a_failure_ends_the_wait_for_the_answer(obc: Obc, unit: Any) -> None:
    unit.handlers[(20, 1)] = lambda request: unit.fail(request, 2, 9, 99)
    before_ns = obc.now_ns()
    with pytest.raises(VerificationError, match="UNKNOWN_ID"):
        obc.parameters(["exposure_us"], timeout_s=60)
    assert obc.now_ns() - before_ns == 1_000_000
