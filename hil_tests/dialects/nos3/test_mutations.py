"""Damaged traffic; the same in quantity: ``python -m hil_tests.dialects.nos3.mutations 1000000``."""

from __future__ import annotations

import pytest

from hil_tests.dialects.nos3.mutations import mutate
from st_emulator.protocol.nos3.command_parser import CommandParser


def test_damaged_traffic_stops_nothing():
    report = mutate(20_000, seed=1)
    assert report.octets >= 20_000
    assert report.answered >= 9
    assert report.well_formed > 500


def test_an_exception_of_the_unit_would_be_seen(monkeypatch):
    def broken(self: CommandParser, data: bytes) -> list:
        raise ZeroDivisionError

    monkeypatch.setattr(CommandParser, "receive", broken)
    with pytest.raises(ZeroDivisionError):
        mutate(100, seed=1)


def test_a_parser_that_loses_the_command_behind_a_wrong_trailer_would_be_seen(monkeypatch):
    receive = CommandParser.receive

    def forgetful(self: CommandParser, data: bytes) -> list:
        events = receive(self, data)
        if any(len(event.raw) == 9 and event.raw[7:] != b"\xbe\xef" for event in events):
            self.reset()
        return events

    monkeypatch.setattr(CommandParser, "receive", forgetful)
    with pytest.raises(AssertionError):
        mutate(20_000, seed=1)
