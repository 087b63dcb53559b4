"""The table of modes, held against the same table written out as a picture."""

from __future__ import annotations

import pytest

from st_emulator.firmware_model.modes import MODE_MEANINGS, TRANSITIONS, Mode, ModeEvent, next_mode
from st_emulator.firmware_model.reasons import REASON_MEANINGS, Reason

# One row an event, one column a mode: the mode after, or a dot where the event is not allowed.
COLUMNS = ["BOOT", "SELF_TEST", "STANDBY", "LOST_IN_SPACE", "TRACKING", "FAULT", "OFF", "RATE_ONLY"]
TABLE = """
POWER_ON            .      .      .       .       .       .      BOOT   .
BOOT_DONE           STBY   .      .       .       .       .      .      .
SELF_TEST_STARTED   TEST   .      .       .       .       .      .      .
SELF_TEST_PASSED    .      STBY   .       .       .       .      .      .
SELF_TEST_FAILED    .      FAULT  .       .       .       .      .      .
COMMAND_STANDBY     .      .      STBY    STBY    STBY    .      .      STBY
COMMAND_ACQUIRE     .      .      LIS     LIS     LIS     .      .      LIS
COMMAND_TRACK_FROM  .      .      TRACK   TRACK   TRACK   .      .      TRACK
COMMAND_SELF_TEST   .      .      TEST    .       .       TEST   .      .
COMMAND_RESET       BOOT   BOOT   BOOT    BOOT    BOOT    BOOT   .      BOOT
COMMAND_SHUTDOWN    OFF    OFF    OFF     OFF     OFF     OFF    .      OFF
AUTONOMOUS_START    .      .      LIS     .       .       .      .      .
ATTITUDE_ACQUIRED   .      .      .       TRACK   .       .      .      TRACK
TRACKING_LOST       .      .      .       .       LIS     .      .      .
FAULT_DETECTED      FAULT  FAULT  FAULT   FAULT   FAULT   .      .      FAULT
POWER_OFF           OFF    OFF    OFF     OFF     OFF     OFF    .      OFF
RATE_ALONE          .      .      .       RATE    .       .      .      .
SLOW_AGAIN          .      .      .       .       .       .      .      LIS
"""
SHORT = {
    "BOOT": Mode.BOOT,
    "TEST": Mode.SELF_TEST,
    "STBY": Mode.STANDBY,
    "LIS": Mode.LOST_IN_SPACE,
    "TRACK": Mode.TRACKING,
    "FAULT": Mode.FAULT,
    "OFF": Mode.OFF,
    "RATE": Mode.RATE_ONLY,
    ".": None,
}
ROWS = {row.split()[0]: row.split()[1:] for row in TABLE.strip().splitlines()}


@pytest.mark.parametrize("event", list(ModeEvent), ids=lambda event: event.name)
def test_every_event_does_in_every_mode_what_the_picture_says(event: ModeEvent) -> None:
    for column, short in zip(COLUMNS, ROWS[event.name], strict=True):
        assert next_mode(Mode[column], event) is SHORT[short], column


def test_the_picture_holds_every_event_and_mode() -> None:
    assert set(ROWS) == {event.name for event in ModeEvent}
    assert [Mode[name] for name in COLUMNS] == list(Mode)


def test_the_numbers_are_those_of_the_telemetry() -> None:
    assert [mode.value for mode in Mode] == [0, 1, 2, 3, 4, 5, 6, 7]
    assert [event.value for event in ModeEvent] == list(range(18))
    names = "TOO_FEW_STARS NO_MATCH BLINDED RATE_TOO_HIGH OVERRUN NOT_ACQUIRING FRAME_DROPPED PIVOT_LOST "
    names += "RESIDUAL_TOO_LARGE AMBIGUOUS WORK_LIMIT NO_FRAME TOO_MANY_SPOTS UNCONFIRMED"
    assert {name: 1 << bit for bit, name in enumerate(names.split())} == {r.name: r.value for r in Reason}


def test_every_row_is_there_once_and_says_what_it_means() -> None:
    keys = [(row.mode, row.event) for row in TRANSITIONS]
    assert len(keys) == len(set(keys))
    assert all(row.meaning for row in TRANSITIONS)
    assert set(MODE_MEANINGS) == set(Mode)
    assert set(REASON_MEANINGS) == set(Reason)


def test_what_is_announced() -> None:
    """Every change but the end of the boot, which has a report of its own, and those into silence."""
    silent = {row for row in TRANSITIONS if row.next_mode in (Mode.BOOT, Mode.OFF)}
    boot_done = {row for row in TRANSITIONS if row.event is ModeEvent.BOOT_DONE}
    assert {row for row in TRANSITIONS if not row.announced} == silent | boot_done


def test_no_mode_is_a_trap() -> None:
    for start in Mode:
        reached = {start}
        while True:
            more = {row.next_mode for row in TRANSITIONS if row.mode in reached} | reached
            if more == reached:
                break
            reached = more
        assert reached == set(Mode), start
