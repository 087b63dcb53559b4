"""The kernel's delay loop and its calibration, against what ARM926EJ-S boards printed when they booted."""

from __future__ import annotations

import pytest

from hil_tests.arm.programs import words_of, write_elf
from tools.arm_timing.machine import ArmMachine

# Linux, arch/arm/lib/delay-loop.S (arch/arm/lib/delay.S before 3.6), __loop_delay.
DELAY = """
    e2500001  subs r0, r0, #1
    8afffffd  bhi #0xfffffffc
    e12fff1e  bx lr
"""
# Boot logs, "Calibrating delay loop... 199.06 BogoMIPS (lpj=995328)" and so on: AT91SAM9G20 (396 to 400 MHz)
# and Anyka AK39 ("CPU 400MHz"); NXP i.MX28 (454 MHz: 480 MHz x 18 / 19); HiSilicon Hi3518E V200 (540 MHz).
PRINTED = {
    400_000_000: ("199.06", 995328),
    454_736_842: ("226.09", 1130496),
    540_000_000: ("269.10", 1345536),
}
HZ = 100  # lpj / (500000 / HZ) is what was printed: so these kernels ticked at 100 Hz


@pytest.fixture(scope="module")
def delay(tmp_path_factory: pytest.TempPathFactory) -> ArmMachine:
    elf = write_elf(tmp_path_factory.mktemp("delay") / "delay.elf", {"__delay": words_of(DELAY)})
    return ArmMachine(elf, memory_bytes=32 << 20)


def cycles_of(machine: ArmMachine, loops: int) -> int:
    return machine.call("__delay", loops).cost.core_cycles


def converge(machine: ArmMachine, clock_hz: int) -> int:
    """Linux, init/calibrate.c, calibrate_delay_converge: loops per jiffy, to eight bits.

    The clock is the simulated cycles; the timer's interrupt and the loop around take none.
    """
    cycles_per_jiffy = clock_hz // HZ
    start = 1 << 12
    trials = band = trial_in_band = now = 0
    while now < cycles_per_jiffy:
        trial_in_band += 1
        if trial_in_band == 1 << band:
            band += 1
            trial_in_band = 0
        now += cycles_of(machine, start * band)
        trials += band
    trials -= band
    loop_add, loops = start * band, start * trials
    chop_limit = loops >> 8
    while loop_add > chop_limit:
        loops += loop_add
        if cycles_of(machine, loops) >= cycles_per_jiffy:
            loops -= loop_add
        loop_add >>= 1
    return loops


def printed(loops_per_jiffy: int) -> str:
    """init/calibrate.c, calibrate_delay."""
    return f"{loops_per_jiffy // (500000 // HZ)}.{loops_per_jiffy // (5000 // HZ) % 100:02d}"


def test_the_logs_lines_are_read_right():
    for text, loops_per_jiffy in PRINTED.values():
        assert printed(loops_per_jiffy) == text


def test_a_loop_takes_four_cycles(delay):
    # 1 + 3 each; the last one's branch is not taken (1 instead of 3), the return takes 3.
    assert [cycles_of(delay, loops) for loops in (1, 2, 1000)] == [5, 9, 4001]


@pytest.mark.parametrize("clock_hz", [399_000_000, 400_000_000, 540_000_000])
def test_the_kernel_prints_the_same_to_the_last_digit(delay, clock_hz):
    text, loops_per_jiffy = PRINTED[400_000_000 if clock_hz == 399_000_000 else clock_hz]
    loops = converge(delay, clock_hz)
    assert loops == loops_per_jiffy
    assert printed(loops) == text


@pytest.mark.parametrize("clock_hz", [399_000_000, *PRINTED])
def test_within_one_percent(delay, clock_hz):
    """With and without the eight bits of the kernel's search."""
    text, _ = PRINTED[400_000_000 if clock_hz == 399_000_000 else clock_hz]
    assert float(printed(converge(delay, clock_hz))) == pytest.approx(float(text), rel=0.01)
    loops = 1_000_000
    exact = 2 * clock_hz * loops / cycles_of(delay, loops) / 1e6
    assert exact == pytest.approx(float(text), rel=0.01)
