"""16 bits a component, against the formula in exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil_tests.dialects.nos3 import client
from st_emulator.protocol.nos3.quantisation import STEP, component_of, quantised

# A double near 65536 has steps of 2^-37 and is off by half of one at most after each of two operations.
ROUNDING = Fraction(1, 2**37)
COMPONENTS = st.floats(-1, 1)


@settings(max_examples=500)
@given(COMPONENTS)
@example(math.nextafter(1, 0))
@example(math.nextafter(-1, 0))
@example(5e-324)
@example(-5e-324)
def test_the_formula_in_exact_fractions(component):
    exact = client.exact_u(component)
    u = quantised(component)
    assert u in (math.floor(exact), math.floor(exact + ROUNDING), math.floor(exact - ROUNDING))


@pytest.mark.parametrize(
    ("component", "u"),
    [
        (1.0, 65535),  # 32767 + 32768
        (-1.0, 1),  # -32767 + 32768
        (0.0, 32768),
        (-0.0, 32768),
        (0.5, 49151),  # 16383.5 + 32768 = 49151.5
        (-0.5, 16384),  # -16383.5 + 32768 = 16384.5: towards zero of the sum, which is positive
        (1e-9, 32768),
        (-1e-9, 32767),  # just below zero is a whole step below
        (0.70710678118654752, 55937),  # 23169.77 + 32768 = 55937.77
        (-0.70710678118654752, 9598),  # -23169.77 + 32768 = 9598.23
    ],
)
def test_by_hand(component, u):
    assert quantised(component) == u


def test_every_value_but_0_is_sent_for_some_component_and_comes_back():
    """In the middle of each step, where rounding of doubles decides nothing."""
    for u in range(1, 65535):
        middle = float((Fraction(u) + Fraction(1, 2) - 32768) / 32767)
        assert quantised(middle) == u
        assert quantised(-1 + (u - 1) / 32767) in (u, u - 1)  # at its beginning rounding may decide
    assert quantised(1.0) == 65535


def test_the_rounding_of_a_unit_quaternion_wraps_nowhere():
    for component in (1.0, math.nextafter(1, 2), 1 + 1e-15):
        assert quantised(component) == 65535
    assert quantised(-1.0) == 1
    assert (
        quantised(math.nextafter(-1, -2)) == 0
    )  # 0.99999999999 without its fraction; -1.00003 to the driver


def test_beyond_the_ends_the_nearest_is_sent():
    assert quantised(1 + 1 / 32767) == 65535  # 65536 would be 0 in 16 bits: from one end to the other
    assert quantised(2.0) == 65535
    assert quantised(1e300) == 65535
    assert quantised(-1.0001) == 0
    assert quantised(-2.0) == 0  # -32766: towards zero it would be a large number in 16 bits
    assert quantised(-1e300) == 0


@settings(max_examples=300)
@given(COMPONENTS)
def test_what_the_driver_reads_is_at_most_a_step_too_low(component):
    read = component_of(quantised(component))
    assert -1e-12 <= component - read < STEP + 1e-12
    assert read == (quantised(component) - 32768) / 32767  # the driver's formula


@settings(max_examples=300)
@given(COMPONENTS, COMPONENTS)
def test_it_keeps_the_order(one, other):
    if one <= other:
        assert quantised(one) <= quantised(other)


@settings(max_examples=500)
@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
def test_the_attitude_is_off_by_no_more_than_the_document_says(q):
    norm = math.hypot(*q)
    q = tuple(value / norm for value in q)
    read = [component_of(quantised(value)) for value in q]
    for shift, most_arcsec in ((0.0, 25.2), (STEP / 2, 12.6)):
        sent = [value + shift for value in read]
        # The difference across q, doubled, is the angle.
        along = sum(a * b for a, b in zip(q, sent, strict=True))
        across = math.sqrt(sum((b - along * a) ** 2 for a, b in zip(q, sent, strict=True)))
        assert math.degrees(2 * math.atan(across / along)) * 3600 <= most_arcsec
