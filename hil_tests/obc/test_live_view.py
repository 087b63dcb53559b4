"""What the unit says now, on one screen or in one line."""

import io
import struct
from typing import Any

from rich.console import Console

from st_emulator.obc import Obc
from st_emulator.obc.watching import attitude_line, live_table, watch

#: A covariance of the rate, (rad/s)^2: xx, xy, xz, yy, yz, zz.
SIGMA_3_4_12_ARCSEC = tuple((n / 206_264.806) ** 2 for n in (3, 0, 0, 4, 0, 12))


def drawn(obc: Obc) -> str:
    console = Console(width=120, file=io.StringIO())
    console.print(live_table(obc))
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_the_live_view_before_and_after_the_first_report(obc: Obc, unit: Any) -> None:
    assert "no report yet" in drawn(obc)
    unit.attitude(q=(0.0, 0.0, 0.0, 1.0), rate=(0.0, 0.017453292, 0.0))
    unit.event(6, struct.pack(">II", 3, 2), severity=2)
    obc.wait(0.01)
    text = drawn(obc)
    # 2e9.5 s of TAI since 1958, and 37 leap seconds less in UTC
    assert "2021-05-18T03:32:43.500+00:00" in text
    for part in (
        "TRACKING",
        "dec +90.00000",
        "y +1.00000",
        "12 identified of 20 spots",
        "low: TRACKING_LOST",
    ):
        assert part in text
    assert "y +1.00000  z +0.00000 deg/s" in text
    assert "arcsec/s" not in text, "no more than it tells"
    unit.attitude(
        mode=7, valid=0, reasons=8, rate=(0.0, 0.017453292, 0.0), rate_covariance=SIGMA_3_4_12_ARCSEC
    )
    obc.wait(0.01)
    text = drawn(obc)
    assert "RATE_ONLY" in text
    assert "not valid: RATE_TOO_HIGH" in text
    assert "x +0.00000  y +1.00000  z +0.00000 deg/s, 1 sigma x 3.00  y 4.00  z 12.00 arcsec/s" in text
    unit.attitude(valid=0, reasons=4, rate=None, late=1)
    obc.wait(0.01)
    text = drawn(obc)
    assert "not valid: BLINDED" in text
    assert "late" in text


def test_a_line_says_what_is_known_where_no_attitude_is(obc: Obc, unit: Any) -> None:
    unit.attitude(valid=0, reasons=8, rate=(0.0, 0.0, 0.017453292), rate_covariance=SIGMA_3_4_12_ARCSEC)
    unit.attitude(valid=0, reasons=8, rate=None)
    obc.wait(0.01)
    known, unknown = (attitude_line(attitude) for attitude in obc.attitudes())
    assert known == (
        f"{unknown}  rate x +0.00000  y +0.00000  z +1.00000 deg/s, 1 sigma x 3.00  y 4.00  z 12.00 arcsec/s"
    )


def test_without_a_terminal_the_view_is_a_line_per_report(obc: Obc, unit: Any) -> None:
    for frame in range(4):
        unit.attitude(frame=frame, valid=frame % 2, reasons=0 if frame % 2 else 1, after_ms=250 * frame + 100)
    console = Console(width=120, file=io.StringIO())
    watch(obc, 1.0, console)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert len(lines) == 4
    assert "not valid: TOO_FEW_STARS" in lines[0]
    assert "stars 12/20" in lines[3]


def test_a_terminal_is_drawn_on_again_and_again(obc: Obc, unit: Any) -> None:
    unit.attitude(after_ms=600)
    console = Console(width=120, height=40, file=io.StringIO(), force_terminal=True)
    watch(obc, 1.0, console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "no report yet" in text
    assert "12 identified" in text
