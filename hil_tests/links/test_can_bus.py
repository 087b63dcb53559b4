"""What is special about CAN links: records and frames, CAN FD, error messages, adapters, and what a person
reads when a bus cannot be had.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hil_tests.links.can_far_ends import (
    ERROR,
    EXTENDED,
    FD,
    PATIENCE_S,
    REMOTE,
    LawicelEnd,
    Record,
    SocketEnd,
    VirtualEnd,
    taken_apart,
)
from st_emulator.links import LinkError, open_link
from st_emulator.links.can import socketcan
from st_emulator.links.can.bus import VIRTUAL_QUEUE_FRAMES, CanLink
from st_emulator.links.network_interface import network_interface

BIT_RATE_SWITCH = 1
PLAIN = Record(0x123, 3, data=b"abc").pack()
LONG = Record(0x1ABCDEF | EXTENDED, 64, FD | BIT_RATE_SWITCH, bytes(range(64))).pack()
SHORT_FD = Record(0x7FF, 0, FD).pack()


@pytest.fixture(params=["virtual", pytest.param("vcan0", marks=pytest.mark.vcan)])
def bus(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, str]:
    """Interface and channel of a bus with several nodes."""
    return ("socketcan", "vcan0") if request.param == "vcan0" else ("virtual", str(tmp_path))


def text(bus: tuple[str, str], ending: str = "") -> str:
    return f"can:{bus[0]}/{bus[1]}{ending}"


def await_bytes(link: CanLink, length: int) -> bytes:
    received = b""
    deadline = time.monotonic() + PATIENCE_S
    while len(received) < length and time.monotonic() < deadline:
        received += link.read()
    return received


# -- records


def test_what_is_opened_has_the_units_bit_rate_unless_its_text_names_one(tmp_path: Path) -> None:
    with open_link(f"can:virtual/{tmp_path}", bitrate=250_000) as link:
        assert isinstance(link, CanLink)
        assert (link.bitrate, link.fd, link.hardware) == (250_000, False, False)
        assert link.name == f"can:virtual/{tmp_path}@250000"
        assert link.fileno() is None
    with open_link(f"can:virtual/{tmp_path}@500000,fd", role="obc", bitrate=250_000) as link:
        assert isinstance(link, CanLink)
        assert (link.bitrate, link.fd) == (500_000, True)
    with open_link(f"can:virtual/{tmp_path}") as link:
        assert isinstance(link, CanLink)
        assert link.bitrate == 1_000_000


@pytest.mark.parametrize(
    "refused",
    [
        Record(0x800, 0).pack(),  # 12 bits
        Record(1, 9, data=bytes(9)).pack(),
        Record(1, 9, FD, bytes(9)).pack(),  # no length of CAN FD
        Record(1, 0, FD).pack(),  # not without ,fd
        Record(1 | REMOTE, 9).pack(),
        Record(4 | ERROR, 8, data=bytes(8)).pack(),  # controllers make them, nobody sends them
    ],
)
def test_what_is_no_frame_to_be_sent_is_dropped_with_all_behind_it(
    bus: tuple[str, str], refused: bytes
) -> None:
    with open_link(text(bus)) as link, open_link(text(bus, ",fd")) as other:
        assert link.write(PLAIN + refused + PLAIN) == len(PLAIN)
        assert link.dropped_bytes == len(refused + PLAIN)
        assert link.write(PLAIN) == len(PLAIN)
        assert await_bytes(other, 2 * len(PLAIN)) == 2 * PLAIN
        assert other.read() == b""


@pytest.mark.parametrize("part", [PLAIN[:-1], PLAIN[:7], b"x"])
def test_part_of_a_record_is_dropped(bus: tuple[str, str], part: bytes) -> None:
    with open_link(text(bus)) as link, open_link(text(bus)) as other:
        assert link.write(PLAIN + part) == len(PLAIN)
        assert link.dropped_bytes == len(part)
        assert link.write(PLAIN) == len(PLAIN)
        assert await_bytes(other, 2 * len(PLAIN)) == 2 * PLAIN


def test_all_but_the_sender_hear_a_frame(bus: tuple[str, str]) -> None:
    with open_link(text(bus)) as one, open_link(text(bus)) as two, open_link(text(bus)) as three:
        assert one.write(PLAIN) == len(PLAIN)
        assert await_bytes(two, len(PLAIN)) == await_bytes(three, len(PLAIN)) == PLAIN
        assert one.read() == two.read() == three.read() == b""


def test_fd_frames_pass_between_those_who_speak_fd(bus: tuple[str, str]) -> None:
    with open_link(text(bus, ",fd")) as one, open_link(text(bus, ",fd")) as two, open_link(text(bus)) as old:
        assert one.write(LONG + PLAIN + SHORT_FD) == len(LONG + PLAIN + SHORT_FD)
        assert await_bytes(two, len(LONG + PLAIN + SHORT_FD)) == LONG + PLAIN + SHORT_FD
        assert await_bytes(old, len(PLAIN)) == PLAIN
        assert old.read() == b""


def test_fd_frames_and_error_messages_of_a_far_end(bus: tuple[str, str]) -> None:
    error = Record(ERROR | 0x40, 8, data=bytes(range(8))).pack()  # bus-off
    far = SocketEnd(fd=True) if bus[0] == "socketcan" else VirtualEnd(bus[1])
    with open_link(text(bus, ",fd")) as link:
        assert link.write(LONG + SHORT_FD) == len(LONG + SHORT_FD)
        assert far.read() == LONG + SHORT_FD
        far.write(error + LONG + PLAIN)
        assert await_bytes(link, len(error + LONG + PLAIN)) == error + LONG + PLAIN
    far.close()


def test_a_node_that_does_not_read_stops_nobody(tmp_path: Path) -> None:
    with (
        CanLink("virtual", str(tmp_path), 1_000_000) as link,
        CanLink("virtual", str(tmp_path), 1_000_000) as deaf,
    ):
        far = VirtualEnd(str(tmp_path), queue_frames=10)
        for _ in range(11):
            assert link.write(PLAIN) == len(PLAIN)
        assert far.read() == 10 * PLAIN
        assert deaf.read() == 11 * PLAIN
        far.close()
        many = PLAIN * 1000
        for _ in range(VIRTUAL_QUEUE_FRAMES // 1000 + 2):
            assert link.write(many) == len(many)
        received = b""
        while data := deaf.read():
            received += data
        assert received == PLAIN * VIRTUAL_QUEUE_FRAMES


# -- SocketCAN


@pytest.mark.vcan
def test_a_burst_that_nobody_reads_meanwhile_is_not_lost() -> None:
    numbers = range(20_000)
    with CanLink("socketcan", "vcan0", 1_000_000) as link:
        far = SocketEnd()
        for number in numbers:
            far.socket.send(struct.pack("=IB3x8s", 0x100, 4, struct.pack(">I", number)))
        received = b""
        while data := link.read():
            received += data
        far.close()
        assert [record.data for record in taken_apart(received)] == [struct.pack(">I", n) for n in numbers]
        assert link.receive_overruns == 0


@pytest.mark.vcan
def test_what_did_not_fit_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socketcan, "RECEIVE_BUFFER_BYTES", 20_000)
    with CanLink("socketcan", "vcan0", 1_000_000) as link:
        far = SocketEnd()
        far.write(PLAIN * 1000)
        received = len(link.read()) // len(PLAIN)
        assert 0 < received < 1000
        assert link.receive_overruns == 1000 - received
        far.write(PLAIN)
        assert link.read() == PLAIN
        far.close()


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True, timeout=60)


@pytest.fixture
def own_interface() -> Iterator[str]:
    """A vcan that a test may take down."""
    if os.geteuid() != 0:
        pytest.skip("only root may make network interfaces")
    ip("add", "dev", "vcan_test", "type", "vcan")
    ip("set", "vcan_test", "mtu", "72", "up")
    yield "vcan_test"
    if network_interface("vcan_test"):
        ip("del", "vcan_test")


@pytest.mark.vcan
def test_a_bus_that_goes_down_gives_what_had_come_and_then_says_so(own_interface: str) -> None:
    far = SocketEnd(own_interface)
    with (
        CanLink("socketcan", own_interface, 1_000_000) as link,
        CanLink("socketcan", own_interface, 1_000_000) as other,
    ):
        far.write(PLAIN)
        ip("set", own_interface, "down")
        assert other.read() == PLAIN
        for operation in (other.read, lambda: other.write(PLAIN)):
            with pytest.raises(
                LinkError, match=r"vcan_test@1000000: the interface went down; .* set vcan_test up$"
            ):
                operation()
        with pytest.raises(LinkError, match="the interface went down"):
            link.write(PLAIN)
        with pytest.raises(
            LinkError, match="the interface is down; bring it up, as root: ip link set vcan_test up"
        ):
            CanLink("socketcan", own_interface, 1_000_000)
        ip("set", own_interface, "mtu", "16", "up")
        with pytest.raises(
            LinkError, match=r"carries no CAN FD; leave out ,fd or, .* vcan_test mtu 72 && ip link"
        ):
            CanLink("socketcan", own_interface, 1_000_000, fd=True)
        with CanLink("socketcan", own_interface, 1_000_000) as again:
            ip("del", own_interface)
            with pytest.raises(LinkError, match=r"the interface (was removed|went down)"):
                again.write(PLAIN)
            with pytest.raises(LinkError, match=r"the interface (was removed|went down)"):
                again.read()
    far.close()


@pytest.mark.vcan
def test_a_controllers_bit_rate_must_be_the_links() -> None:
    """The kernel's slcan is a controller with a bit rate, and pseudo-terminals are all that it needs."""
    if os.geteuid() != 0:
        pytest.skip("only root may make network interfaces")
    master, slave = os.openpty()
    tty.setraw(slave)
    reader = threading.Thread(target=read_until_closed, args=(master,), daemon=True)
    reader.start()
    daemon = subprocess.Popen(["slcand", "-F", os.ttyname(slave), "slcan7"], stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + PATIENCE_S
        while network_interface("slcan7") is None:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        with pytest.raises(
            LinkError, match="is down; bring it up, as root: ip link set slcan7 up type can bitrate"
        ):
            CanLink("socketcan", "slcan7", 500_000)
        ip("set", "slcan7", "up", "type", "can", "bitrate", "250000")
        with pytest.raises(
            LinkError, match="is set to 250000 bit/s; ask for @250000 or, as root: ip link set"
        ):
            CanLink("socketcan", "slcan7", 500_000)
        with pytest.raises(LinkError, match=r"carries no CAN FD; .* type can fd on dbitrate BITRATE"):
            CanLink("socketcan", "slcan7", 250_000, fd=True)
        with CanLink("socketcan", "slcan7", 250_000) as link:
            assert link.hardware
    finally:
        daemon.terminate()
        daemon.wait(PATIENCE_S)
        os.close(slave)
        reader.join(PATIENCE_S)
        os.close(master)


def read_until_closed(fd: int) -> None:
    try:
        while os.read(fd, 4096):
            pass
    except OSError:
        pass


@pytest.mark.vcan
def test_a_vcan_is_no_hardware_and_can_be_selected_on() -> None:
    with CanLink("socketcan", "vcan0", 1_000_000) as link:
        assert not link.hardware
        assert isinstance(link.fileno(), int)


@pytest.mark.vcan
@pytest.mark.parametrize(
    ("channel", "message"),
    [
        (
            "vcan9",
            "no such network interface; make it, as root: ip link add dev vcan9 type vcan && ip link set",
        ),
        ("can9", "no such network interface; `ip link` lists those there are; ./tools/vcan COMMAND"),
        ("lo", "this network interface is no CAN bus"),
    ],
)
def test_a_bus_that_is_not_there(channel: str, message: str) -> None:
    with pytest.raises(LinkError) as error:
        open_link(f"can:socketcan/{channel}")
    assert str(error.value).startswith(f"can:socketcan/{channel}@1000000: {message}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (errno.EAFNOSUPPORT, "this computer's kernel has no CAN; ./tools/vcan COMMAND"),
        (errno.EPROTONOSUPPORT, "this computer's kernel has no CAN"),
        (errno.EPERM, "no CAN socket to be had: Operation not permitted"),
    ],
)
def test_a_kernel_that_gives_no_socket(monkeypatch: pytest.MonkeyPatch, number: int, message: str) -> None:
    def refuse(*arguments: object) -> socket.socket:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(socketcan.socket, "socket", refuse)
    with pytest.raises(LinkError) as error:
        open_link("can:socketcan/vcan0")
    assert str(error.value).startswith(f"can:socketcan/vcan0@1000000: {message}")


def test_an_interface_is_as_the_kernels_files_say() -> None:
    found = network_interface("lo")
    assert found is not None
    folder = Path("/sys/class/net/lo")
    assert found.mtu == int((folder / "mtu").read_text())
    assert found.is_up == bool(int((folder / "flags").read_text(), 16) & 1)
    assert (found.is_can, found.bitrate) == (False, 0)
    assert network_interface("no_such_one") is None


# -- slcan


@pytest.fixture
def adapter() -> Iterator[tuple[LawicelEnd, str]]:
    """The adapter's end and the path of its port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield LawicelEnd(master), os.ttyname(slave)
    os.close(slave)
    os.close(master)


def test_an_adapter_is_set_up_and_closed(adapter: tuple[LawicelEnd, str]) -> None:
    far, path = adapter
    with CanLink("slcan", path, 500_000, opening_s=0) as link:
        assert link.hardware
        assert isinstance(link.fileno(), int)
        assert link.write(PLAIN) == len(PLAIN)
        assert far.read() == PLAIN
        assert far.commands[:2] == ["C", "S6"]  # closed, 500 kbit/s
        assert far.commands[-1] == "O"  # open
    assert far.read(patience_s=0) == b""
    assert far.commands[-1] == "C"


def test_the_time_that_an_adapter_is_given_to_wake_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Adapters on an Arduino reset when their port is opened: python-can waits two seconds, and so do we."""
    waited = []
    monkeypatch.setattr(time, "sleep", waited.append)
    master, slave = os.openpty()
    tty.setraw(slave)
    open_link(f"can:slcan/{os.ttyname(slave)}").close()
    assert waited == [2.0]
    os.close(master)
    os.close(slave)


def test_garbled_lines_are_counted_and_answers_are_not_frames(adapter: tuple[LawicelEnd, str]) -> None:
    far, path = adapter
    garbled = [
        b"t12\r",
        b"t1234AA\r",
        b"tXYZ0\r",
        b"t1239001122334455667788\r",
        b"T12\r",
        b"t8000\r",
        b"\xff\xfe\r",
    ]
    answers = [b"\r", b"z\r", b"Z\r", b"\a", b"V1013\r", b"F00\r"]
    with CanLink("slcan", path, 1_000_000, opening_s=0) as link:
        os.write(far.fd, b"".join(garbled[:-1]) + b"".join(answers) + garbled[-1] + b"t1233616")
        assert await_frames(link, lambda: link.unreadable_frames >= len(garbled) - 1) == b""
        os.write(far.fd, b"263\rt1")
        assert await_bytes(link, len(PLAIN)) == PLAIN
        os.write(far.fd, b"233616263\r")
        assert await_bytes(link, len(PLAIN)) == PLAIN
        assert link.unreadable_frames == len(garbled) - 1  # bytes that are no text begin no frame


def await_frames(link: CanLink, done: Callable[[], bool]) -> bytes:
    received = b""
    deadline = time.monotonic() + PATIENCE_S
    while not done() and time.monotonic() < deadline:
        received += link.read()
    return received


@pytest.mark.parametrize(
    ("channel", "message"),
    [
        ("/dev/null", "the adapter cannot be opened: this device is no serial port"),
        ("/dev", "no serial port; name the adapter's, such as can:slcan//dev/ttyACM0"),
        ("/dev/ttyACM99", "no such device; name the adapter's serial port, such as can:slcan//dev/ttyACM0"),
    ],
)
def test_an_adapter_that_is_not_there(channel: str, message: str) -> None:
    with pytest.raises(LinkError) as error:
        open_link(f"can:slcan/{channel}")
    assert str(error.value) == f"can:slcan/{channel}@1000000: {message}"


def test_a_bit_rate_that_adapters_do_not_have() -> None:
    with pytest.raises(
        LinkError, match=r"@33333: slcan has no such bit rate; allowed are 10000, 20000, .* bit/s$"
    ):
        open_link("can:slcan//dev/ttyACM99@33333")


def test_a_busy_adapter_is_named_and_free_again_after_close(adapter: tuple[LawicelEnd, str]) -> None:
    _, path = adapter
    with CanLink("slcan", path, 1_000_000, opening_s=0):
        with pytest.raises(LinkError, match="the adapter is busy: another program has its port open"):
            CanLink("slcan", path, 1_000_000, opening_s=0)
        with pytest.raises(LinkError, match="the port is busy"):
            open_link(f"serial:{path}")
    CanLink("slcan", path, 1_000_000, opening_s=0).close()


# -- python-can


def test_python_can_says_nothing_of_its_own() -> None:
    program = """
from st_emulator.links import LinkError, open_link
open_link("can:virtual/x").write(b"unclosed")
for text in ("can:socketcan/no_such", "can:slcan//dev/null", "can:slcan//dev/no_such"):
    try:
        open_link(text)
    except LinkError as error:
        print(error)
"""
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, timeout=60
    )
    assert (run.returncode, run.stderr, run.stdout.count("\n")) == (0, "", 3)


def test_no_interface_but_the_three(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="unknown CAN interface; allowed are socketcan, slcan and virtual"):
        CanLink("udp_multicast", "239.0.0.1", 1_000_000)
