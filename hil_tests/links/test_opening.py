"""What a person writes after --link, and what a person reads when it is wrong."""

import os
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from st_emulator.links import LinkError, LinkSpecification, NullLink, open_link, parse_link
from st_emulator.links.serial_port import SerialLink


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("none", LinkSpecification("none")),
        ("pty", LinkSpecification("pty")),
        ("pty:/run/st/a b", LinkSpecification("pty", "/run/st/a b")),
        ("pty:relative", LinkSpecification("pty", "relative")),
        ("serial:/dev/ttyUSB0", LinkSpecification("serial", "/dev/ttyUSB0")),
        ("serial:/dev/ttyUSB0@921600", LinkSpecification("serial", "/dev/ttyUSB0", 921_600)),
        ("serial:/dev/by@id/x@300", LinkSpecification("serial", "/dev/by@id/x", 300)),
        ("/dev/ttyS1", LinkSpecification("serial", "/dev/ttyS1")),
        ("./pty-of-unit@4000000", LinkSpecification("serial", "./pty-of-unit", 4_000_000)),
    ],
)
def test_forms(text: str, expected: LinkSpecification) -> None:
    assert parse_link(text) == expected


@pytest.mark.parametrize("text", ["none", "pty", "pty:/a", "serial:/dev/ttyUSB0", "serial:/dev/ttyUSB0@9600"])
def test_a_specification_reads_as_it_was_written(text: str) -> None:
    assert str(parse_link(text)) == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "unknown kind of link; allowed are none, pty, "),
        ("usb", "unknown kind of link"),
        ("none:x", "unknown kind of link"),
        ("tcp:localhost:1", "unknown kind of link"),
        ("pty:", "the path is missing"),
        ("serial", "the device is missing"),
        ("serial:", "the device is missing"),
        ("serial:@9600", "the device is missing"),
        ("serial:/dev/ttyS0@", "'' is no line rate; allowed are 300 to 4000000"),
        ("serial:/dev/ttyS0@fast", "'fast' is no line rate"),
        ("serial:/dev/ttyS0@-9600", "'-9600' is no line rate"),
        ("serial:/dev/ttyS0@299", "'299' is no line rate"),
        ("serial:/dev/ttyS0@4000001", "is no line rate"),
        ("serial:/dev/ttyS0@９６００", "is no line rate"),
    ],
)
def test_errors_say_what_is_wrong_and_what_is_allowed(text: str, message: str) -> None:
    with pytest.raises(LinkError) as error:
        parse_link(text)
    assert message in str(error.value)
    assert str(error.value).startswith(f"link {text!r}: ")
    assert "\n" not in str(error.value)


@pytest.fixture
def port() -> Iterator[str]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_none_takes_and_gives_nothing() -> None:
    with open_link("none") as link:
        assert isinstance(link, NullLink)
        assert link.read() == b""
        assert link.write(b"abc") == 0
        assert link.dropped_bytes == 3


def test_the_rate_in_the_text_beats_the_units_own(port: str) -> None:
    with open_link(f"serial:{port}@9600", baud=57_600) as link:
        assert isinstance(link, SerialLink)
        assert link.baud == 9600
    with open_link(f"serial:{port}", baud=57_600) as link:
        assert isinstance(link, SerialLink)
        assert link.baud == 57_600


def test_a_missing_port(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"^serial:\S+/ttyUSB9@115200: no such device; name a serial port"):
        open_link(f"serial:{tmp_path}/ttyUSB9")


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("x")
    with pytest.raises(LinkError, match="no device; name a serial port"):
        open_link(f"{tmp_path}/notes")


def test_a_device_that_is_no_serial_port() -> None:
    with pytest.raises(LinkError, match=r"^serial:/dev/null@115200: this device is no serial port$"):
        open_link("serial:/dev/null")


def test_a_busy_port_is_named_and_free_again_after_close(port: str) -> None:
    with open_link(f"serial:{port}"), pytest.raises(LinkError, match="the port is busy"):
        open_link(f"serial:{port}")
    open_link(f"serial:{port}").close()


def test_an_obc_without_an_emulator(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"^pty:\S+/unit: no pseudo-terminal there; start the emulator"):
        open_link(f"pty:{tmp_path}/unit", role="obc")


def test_bytes_from_before_opening_are_discarded() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    os.write(master, b"before")
    with open_link(f"serial:{os.ttyname(slave)}") as link:
        assert link.read() == b""
    os.close(master)
    os.close(slave)
