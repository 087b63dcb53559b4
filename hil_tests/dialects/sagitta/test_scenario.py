"""A scenario's telecommands by name, the settings, the registry, the exchange and the document."""

from __future__ import annotations

import re
import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from hil_tests.dialects.demo_session import Session
from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import Bench, unit
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario, ScenarioTelecommand
from st_emulator.bench.scenario_inputs import check_inputs
from st_emulator.commands.warm_up import warm_up
from st_emulator.dialects.registry import dialect_named, settings_of
from st_emulator.dialects.sagitta.exchange import exchange
from st_emulator.dialects.sagitta.scenario_sender import TELECOMMANDS, encode_telecommand
from st_emulator.dialects.sagitta.settings import SagittaSettings
from st_emulator.errors import ConfigurationError
from st_emulator.protocol.errors import LocalProtocolError
from st_emulator.wire.can.wiring import CanWiring

ROOT = Path(__file__).parents[3]
SETTINGS = SagittaSettings()


def test_a_scenario_boots_sets_and_asks() -> None:
    items = [
        (0.5, "boot", {}),
        (1.0, "set_camera", {"exposure_s": 0.05}),
        (1.1, "read_camera", {}),
        (1.2, "set_time", {"utc": "2026-01-15T00:00:01.2Z"}),
        (1.3, "set_subscription", {"telemetry_ids": [27] + [0] * 15}),
        (1.6, "request_time", {}),
    ]
    scenario = Scenario(
        telecommands=[
            *(ScenarioTelecommand(at_s=at_s, name=name, fields=fields) for at_s, name, fields in items),
            ScenarioTelecommand(at_s=1.7, raw_hex=client.request(client.READ, 13).hex()),
        ]
    )
    bench = Bench(unit(autonomous=False), scenario)
    bench.run(2500)
    assert [(frame.type, frame.id) for frame in bench.frames] == [
        (0x83, 1), (0x80, 9), (0x81, 9), (0x83, 14), (0x80, 18), (0x82, 1), (0x81, 13), (0x84, 27)
    ]  # fmt: skip
    assert bench.frames[2].arguments == client.camera(0.05)
    off_us = bench.frames[5].time_us - (1_768_435_200_000_000 + bench.frames[5].t_ns // 1000)
    assert abs(off_us) < 10_000  # sent, and in force, a few ms after 1.2 s


def test_every_telecommand_by_its_defaults() -> None:
    for name, (type_, id_, _) in TELECOMMANDS.items():
        if name == "set_time":
            continue
        arguments = {0: client.DEFAULTS.get(id_, b""), 3: b"\x01"}.get(int(type_), b"")
        assert encode_telecommand(SETTINGS, name, {}) == client.body(type_, id_, arguments)
    kinds = {(int(type_), id_) for type_, id_, _ in TELECOMMANDS.values()}
    assert kinds == {
        *((0, id_) for id_ in client.DEFAULTS),
        *((1, id_) for id_ in client.DEFAULTS),
        *((2, id_) for id_ in client.TELEMETRY_BODY_BYTES),
        (3, 1),
        (3, 14),
    }


def test_time_by_number_or_date_and_words_by_the_setting() -> None:
    number = 1_768_435_200_250_000
    wanted = client.body(3, 14, number.to_bytes(8, "little"))
    moment = datetime(2026, 1, 15, 0, 0, 0, 250_000, UTC)
    assert encode_telecommand(SETTINGS, "set_time", {"unix_us": number}) == wanted
    assert encode_telecommand(SETTINGS, "set_time", {"utc": moment}) == wanted
    assert encode_telecommand(SETTINGS, "set_time", {"utc": moment.isoformat()}) == wanted
    swapped = SagittaSettings(set_time_words="high_first", address=0x42)
    octets = struct.pack("<II", number >> 32, number & 0xFFFFFFFF)
    assert encode_telecommand(swapped, "set_time", {"unix_us": number}) == client.body(3, 14, octets, 0x42)


@pytest.mark.parametrize(
    ("name", "fields", "field"),
    [
        ("reset", {}, "name"),
        ("boot", {"place": 1}, "place"),
        ("request_power", {"x": 1}, "x"),
        ("set_camera", {"exposure_s": "long"}, "exposure_s"),
        ("set_subscription", {"telemetry_ids": [1]}, "telemetry_ids"),
        ("set_time", {}, "unix_us"),
        ("set_time", {"time": "2026-01-15T00:00:00Z"}, "time"),
        ("set_time", {"utc": "yesterday"}, "utc"),
        ("set_time", {"utc": 5}, "utc"),
        ("set_time", {"utc": "0001-01-01T00:00:00+14:00"}, "utc"),
        ("set_time", {"utc": "2026-01-15T00:00:00"}, "utc"),
        ("set_time", {"unix_us": 2**64}, "unix_us"),
        ("set_camera", {"exposure_s": 10**400}, "exposure_s"),
        ("set_blob_filter", {"filters": {"high": 1}}, "filters"),
        ("set_time", {"utc": "2026-01-15T00:00:00Z", "unix_us": 1}, "utc"),
    ],
)
def test_what_cannot_be_sent_is_named(name: str, fields: dict[str, Any], field: str) -> None:
    with pytest.raises(LocalProtocolError) as caught:
        encode_telecommand(SETTINGS, name, fields)
    assert (caught.value.message, caught.value.field) == (name, field)
    scenario = Scenario(telecommands=[ScenarioTelecommand(at_s=1, name=name, fields=fields)])
    with pytest.raises(ConfigurationError, match=r"telecommands\.0"):
        check_inputs(unit(), scenario)


@pytest.mark.parametrize(
    "settings",
    [
        {"address": 256},
        {"boresight": "x"},
        {"solution_rate_hz": 0},
        {"subscription_slots": 17},
        {"colour": 1},
    ],
)
def test_settings_that_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=f"dialects.sagitta: {next(iter(settings))}"):
        settings_of(unit(**settings))


def test_kernels_are_warmed_up_whatever_the_unit_speaks() -> None:
    warm_up(unit())


def test_there_is_no_can_bus() -> None:
    with pytest.raises(ConfigurationError, match=r"sagitta.* no CAN bus"):
        Emulator(unit(), can=CanWiring())


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("roja1", {}),
        ("zy3", {"boresight": "+z", "set_time_words": "high_first", "parameter_status": True}),
    ],
)
def test_the_exchange_holds_its_checks(name: str, settings: dict[str, Any]) -> None:
    session = Session(unit(name, **settings))
    exchange(session)
    assert len(session.checks) == 10
    assert all(session.checks.values()), session.checks
    assert any("HIP" in text for text in session.said)


def test_the_exchange_sees_a_unit_that_finds_nothing() -> None:
    session = Session(unit(autonomous=False))
    exchange(session)
    assert [name for name, holds in session.checks.items() if not holds] == [
        "sagitta_valid_solutions",
        "sagitta_cross_boresight_shift",
        "sagitta_cross_boresight_scatter_rms",
    ]


def test_the_exchange_sees_a_unit_that_says_nothing() -> None:
    session = Session(unit(), deaf=True)
    exchange(session)
    held = [name for name, holds in session.checks.items() if holds]
    assert held == ["sagitta_boot_loader_answers", "sagitta_bad_hashes"]
    assert len(session.checks) == 10


def test_the_document_is_fresh_and_says_everything() -> None:
    document = dialect_named("sagitta").document
    assert document is not None
    text = document()
    assert (ROOT / "docs" / "dialects" / "sagitta.md").read_text(encoding="utf-8") == text
    for id_, octets in client.PARAMETER_BYTES.items():
        assert any(
            line.startswith(f"### {id_} ") and f"({octets} bytes)" in line for line in text.splitlines()
        )
    for id_, octets in client.TELEMETRY_BODY_BYTES.items():
        assert any(
            line.startswith(f"### {id_} ") and f"({octets} bytes" in line for line in text.splitlines()
        )
    for name in SagittaSettings.model_fields:
        assert f"| `{name}`" in text
    assert text.count("ASSUMED") > 20


def test_the_frames_of_the_document_are_those_of_the_other_end() -> None:
    text = (ROOT / "docs" / "dialects" / "sagitta.md").read_text(encoding="utf-8")
    shown = [bytes.fromhex(octets) for octets in re.findall(r"`(C0(?: [0-9A-F]{2})+)`", text)]
    assert shown == [
        client.framed(client.body(client.ACTION, client.BOOT, b"\x01")),
        client.framed(client.body(client.ACTION_REPLY, client.BOOT, b"\x00")),
        client.framed(client.body(client.READ, 9)),
        client.framed(client.body(client.SET_REPLY, 9, b"\x00")),
        client.framed(client.body(client.REQUEST, client.SOLUTION)),
    ]
    assert 0xDB in shown[2][1:-1], "the one that shows an escape"
    for prefix in ("set_camera", "set_time", "boot"):
        assert prefix in TELECOMMANDS
    assert all(name.partition("_")[0] in ("set", "read", "request", "boot") for name in TELECOMMANDS)
