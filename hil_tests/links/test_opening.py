"""What a person writes after --link, and what a person reads when it is wrong."""

import os
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from st_emulator.links import LinkError, LinkSpecification, NullLink, open_link, parse_link
from st_emulator.links.serial_port import SerialLink


def can_of(interface: str, channel: str, bitrate: int | None = None, fd: bool = False) -> LinkSpecification:
    return LinkSpecification("can", channel, interface=interface, bitrate=bitrate, fd=fd)


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
        ("can:socketcan/vcan0", can_of("socketcan", "vcan0")),
        ("can:socketcan/can0@500000", can_of("socketcan", "can0", 500_000)),
        ("can:socketcan/can0@10000,fd", can_of("socketcan", "can0", 10_000, True)),
        ("can:socketcan/vcan0,fd", can_of("socketcan", "vcan0", fd=True)),
        ("can:slcan//dev/ttyACM0@1000000", can_of("slcan", "/dev/ttyACM0", 1_000_000)),
        ("can:slcan/dev/ttyACM0", can_of("slcan", "/dev/ttyACM0")),
        ("can:slcan/ttyACM0", can_of("slcan", "ttyACM0")),
        ("can:slcan//dev/by@id/x@50000", can_of("slcan", "/dev/by@id/x", 50_000)),
        ("can:virtual/bench 1,fd", can_of("virtual", "bench 1", fd=True)),
        ("can:virtual/a/b", can_of("virtual", "a/b")),
    ],
)
def test_forms(text: str, expected: LinkSpecification) -> None:
    assert parse_link(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        *("none", "pty", "pty:/a", "serial:/dev/ttyUSB0", "serial:/dev/ttyUSB0@9600"),
        *("can:socketcan/vcan0", "can:socketcan/can0@500000,fd", "can:slcan//dev/ttyACM0@125000"),
        *("can:virtual/bench", "can:virtual/bench,fd"),
    ],
)
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
        ("can", "unknown CAN interface ''; allowed are socketcan, slcan, virtual, as in can:socketcan/vcan0"),
        ("can:vcan0", "unknown CAN interface 'vcan0'; allowed are socketcan, slcan, virtual"),
        ("can:udp_multicast/239.0.0.1", "unknown CAN interface 'udp_multicast'; allowed are"),
        ("can:SocketCAN/vcan0", "unknown CAN interface 'SocketCAN'"),
        ("can:socketcan", "the channel is missing; write can:INTERFACE/CHANNEL[@BITRATE][,fd], as in"),
        ("can:socketcan/", "the channel is missing"),
        ("can:virtual/@500000", "the channel is missing"),
        ("can:socketcan/can0,FD", "unknown option 'FD'; allowed is fd"),
        ("can:socketcan/can0,", "unknown option ''; allowed is fd"),
        ("can:socketcan/can0,fd,fd", "unknown option 'fd,fd'; allowed is fd"),
        ("can:socketcan/can0,fd@500000", "unknown option 'fd@500000'"),
        ("can:socketcan/can0@9999", "'9999' is no CAN bit rate; allowed are 10000 to 1000000 bit/s"),
        ("can:socketcan/can0@1000001", "is no CAN bit rate"),
        ("can:socketcan/can0@", "'' is no CAN bit rate"),
        ("can:socketcan/can0@1M", "'1M' is no CAN bit rate"),
        ("can:socketcan/a name", "'a name' is no name of a network interface"),
        ("can:socketcan//dev/ttyACM0", "is no name of a network interface"),
        ("can:socketcan/sixteen_letters_", "is no name of a network interface"),
        ("can:slcan/dev/ttyACM0,fd", "slcan has no CAN FD; leave out ,fd"),
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
