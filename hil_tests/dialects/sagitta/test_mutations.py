"""20,000 octets of mutated traffic."""

from __future__ import annotations

from hil_tests.dialects.sagitta.mutations import mutate


def test_nothing_raises_and_the_unit_goes_on() -> None:
    report = mutate(20_000, 1)
    assert report.octets >= 20_000
    assert report.answered > 20
    assert report.frames_from_unit > 200
