"""ISO-TP against an implementation that is not ours: PyPI can-isotp, both directions, in virtual time.

It reads the computer's clock inside; here its timers read the bus's.
"""

from __future__ import annotations

import itertools
import random
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import isotp
import isotp.protocol
import isotp.tools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.protocol.transport_bus import FRAME_NS, GOOD, LOST, MS, Bus, Ours, S
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.can.transport import IsoTpSettings

STEP_NS = 1  # its timers are over when more than their time has passed


class Clock:
    """Stands for the module ``time`` inside can-isotp."""

    now_ns = 0

    def perf_counter_ns(self) -> int:
        return self.now_ns

    def perf_counter(self) -> float:
        return self.now_ns / 1e9

    def sleep(self, seconds: float) -> None:
        raise AssertionError("the peer sleeps")


CLOCK = Clock()


@pytest.fixture(autouse=True, scope="module")
def _virtual_time() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(isotp.tools, "time", CLOCK)
        patched.setattr(isotp.protocol, "time", CLOCK)
        yield


class Peer:
    """can-isotp as an end of the bus, with the settings of one of ours turned round."""

    def __init__(self, ours: IsoTpSettings) -> None:
        self.inbox: deque[isotp.CanMessage] = deque()
        self.outbox: deque[isotp.CanMessage] = deque()
        self.errors: list[str] = []
        self.received: list[bytes] = []
        self.transmit_identifier = ours.receive_identifier
        self.extended = ours.extended
        mode = isotp.AddressingMode.Normal_29bits if ours.extended else isotp.AddressingMode.Normal_11bits
        separation_ms = ours.separation_time_us // 1000
        self.layer = isotp.TransportLayerLogic(
            rxfn=lambda timeout: self.inbox.popleft() if self.inbox else None,
            txfn=self.outbox.append,
            address=isotp.Address(mode, txid=ours.receive_identifier, rxid=ours.transmit_identifier),
            error_handler=lambda error: self.errors.append(type(error).__name__),
            params={
                "stmin": separation_ms if separation_ms or not ours.separation_time_us else 0xF5,
                "blocksize": ours.block_size,
                "tx_padding": ours.padding,
                "tx_data_length": ours.frame_bytes,
                # It fills CAN FD frames below 8 bytes only with this.
                "tx_data_min_length": 8 if ours.fd and ours.padding is not None else None,
                "can_fd": ours.fd,
                "bitrate_switch": ours.fd and ours.bit_rate_switch,
                "max_frame_size": ours.max_receive_bytes,
                "rx_flowcontrol_timeout": ours.n_bs_ns // MS,
                "rx_consecutive_frame_timeout": ours.n_cr_ns // MS,
                "wftmax": ours.wait_frames_max,
                "wait_func": lambda seconds: None,
            },
        )

    def send(self, data: bytes) -> None:
        self.layer.send(data)

    def receive(self, frame: CanFrame, now_ns: int) -> None:
        self.inbox.append(
            isotp.CanMessage(
                frame.identifier,
                data=frame.data,
                extended_id=frame.extended,
                is_fd=frame.fd,
                bitrate_switch=frame.bit_rate_switch,
            )
        )
        self.poll(now_ns)

    def confirmed(self, frame: CanFrame, now_ns: int) -> None:
        pass

    def poll(self, now_ns: int) -> None:
        CLOCK.now_ns = now_ns
        self.layer.process()
        while (data := self.layer.recv()) is not None:
            self.received.append(bytes(data))

    def next_frame(self, now_ns: int) -> CanFrame | None:
        self.poll(now_ns)
        if not self.outbox:
            return None
        message = self.outbox.popleft()
        assert (message.arbitration_id, message.is_extended_id) == (self.transmit_identifier, self.extended)
        return CanFrame(
            message.arbitration_id,
            bytes(message.data),
            extended=message.is_extended_id,
            fd=message.is_fd,
            bit_rate_switch=message.bitrate_switch,
        )

    def next_deadline_ns(self, now_ns: int) -> int | None:
        layer = self.layer
        timers = [layer.timer_rx_fc, layer.timer_rx_cf]
        if layer.is_tx_transmitting_cf():
            timers.append(layer.timer_tx_stmin)
        times = [now_ns + timer.remaining_ns() + STEP_NS for timer in timers if not timer.is_stopped()]
        return min(times, default=None)

    def is_idle(self) -> bool:
        return not self.layer.transmitting() and not self.layer.is_rx_active()


def both(**choices: object) -> tuple[Ours, Peer, Bus]:
    identifiers = (0x18DAF110, 0x18DA10F1) if choices.get("extended") else (0x58A, 0x60A)
    settings_ = IsoTpSettings(*identifiers, **choices)  # type: ignore[arg-type]
    ours, peer = Ours(settings_), Peer(settings_)
    return ours, peer, Bus((ours, peer))


def pattern(length: int) -> bytes:
    return random.Random(length).randbytes(length)


def check(packets: list[bytes], **choices: object) -> None:
    """Each packet there, then each back; the frames of both directions are the same, byte by byte."""
    ours, peer, bus = both(**choices)
    until_ns = 36_000 * S
    ours.to_send.extend(packets)
    bus.run(until_ns)
    assert peer.received == packets
    there = [wire.frame for wire in bus.log]
    bus.log.clear()
    for data in packets:
        peer.send(data)
        bus.run(until_ns)
    assert ours.received == packets
    back = [wire.frame for wire in bus.log]
    assert (ours.failures, peer.errors) == ([], [])
    assert ours.is_idle()
    assert peer.is_idle()
    settings_ = ours.connection.settings
    turned = {
        settings_.transmit_identifier: settings_.receive_identifier,
        settings_.receive_identifier: settings_.transmit_identifier,
    }
    assert [replace(frame, identifier=turned[frame.identifier]) for frame in back] == there


FORMATS: dict[str, dict[str, object]] = {
    "classic": {},
    "classic, 29 bits": {"extended": True},
    "classic, as short as can be": {"padding": None},
    "fd 8": {"fd": True},
    "fd 12": {"fd": True, "frame_bytes": 12},
    "fd 16, 29 bits": {"fd": True, "frame_bytes": 16, "extended": True},
    "fd 20": {"fd": True, "frame_bytes": 20, "bit_rate_switch": False},
    "fd 24": {"fd": True, "frame_bytes": 24},
    "fd 32": {"fd": True, "frame_bytes": 32},
    "fd 48": {"fd": True, "frame_bytes": 48},
    "fd 64": {"fd": True, "frame_bytes": 64},
    "fd 64, as short as can be": {"fd": True, "frame_bytes": 64, "padding": None},
    "fd 64, zeros": {"fd": True, "frame_bytes": 64, "padding": 0},
    "fd 64, 29 bits": {"fd": True, "frame_bytes": 64, "extended": True},
}
each_format = pytest.mark.parametrize("name", FORMATS)


@each_format
def test_every_length_at_which_the_frames_change(name: str) -> None:
    size = FORMATS[name].get("frame_bytes", 8)
    assert isinstance(size, int)
    edges = {
        1,
        2,
        6,
        7,
        8,
        9,
        size - 3,
        size - 2,
        size - 1,
        size,
        size + 1,
        2 * size - 4,
        2 * size - 3,
        2 * size - 2,
    }
    edges |= {size - 2 + 16 * (size - 1) + step for step in (-1, 0, 1)} | {4094, 4095}
    check([pattern(length) for length in sorted(edges)], **FORMATS[name])


@each_format
@pytest.mark.parametrize("block_size", [1, 2, 8, 255])
@pytest.mark.parametrize("separation_time_us", [0, 500, 3_000])
def test_blocks_and_separation(name: str, block_size: int, separation_time_us: int) -> None:
    packets = [pattern(length) for length in (5, 100, 700)]
    check(packets, block_size=block_size, separation_time_us=separation_time_us, **FORMATS[name])


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(sorted(FORMATS)),
    st.lists(st.integers(1, 4095), min_size=1, max_size=3),
    st.integers(0, 255),
    st.sampled_from([0, 500, 1_000, 127_000]),
)
def test_any_length(name: str, lengths: list[int], block_size: int, separation_time_us: int) -> None:
    packets = [pattern(length) for length in lengths]
    check(packets, block_size=block_size, separation_time_us=separation_time_us, **FORMATS[name])


@each_format
@pytest.mark.parametrize("length", [4096, 20_000])
def test_lengths_with_the_escape(name: str, length: int) -> None:
    check([pattern(length)], max_receive_bytes=20_000, block_size=50, **FORMATS[name])


@pytest.mark.parametrize("name", ["classic", "fd 64"])
def test_too_long_for_the_other(name: str) -> None:
    ours, peer, bus = both(max_receive_bytes=500, **FORMATS[name])
    ours.to_send.append(pattern(501))
    bus.run()
    assert ours.failures == [("TransmissionFailed", "RECEIVER_OVERFLOW")]
    assert peer.errors == ["FrameTooLongError"]
    peer.errors.clear()
    ours.events.clear()
    peer.send(pattern(501))
    bus.run()
    assert ours.failures == [("ReceptionFailed", "TOO_LONG")]
    assert peer.errors == ["OverflowError"]
    ours.to_send.append(pattern(500))
    peer.send(pattern(500)[::-1])
    bus.run()
    assert (peer.received, ours.received) == ([pattern(500)], [pattern(500)[::-1]])


@pytest.mark.parametrize(
    ("number", "at_ours", "at_peer"),
    [  # of FF FC CF CF FC CF CF: the one that is lost
        (0, [("TransmissionFailed", "TIMEOUT_BS")], []),
        (1, [("TransmissionFailed", "TIMEOUT_BS")], ["ConsecutiveFrameTimeoutError"]),
        (2, [("TransmissionFailed", "TIMEOUT_BS")], ["WrongSequenceNumberError"]),
        (3, [("TransmissionFailed", "TIMEOUT_BS")], ["ConsecutiveFrameTimeoutError"]),
        (4, [("TransmissionFailed", "TIMEOUT_BS")], ["ConsecutiveFrameTimeoutError"]),
        (5, [], ["WrongSequenceNumberError"]),
        (6, [], ["ConsecutiveFrameTimeoutError"]),
    ],
)
def test_a_frame_of_ours_or_its_answer_is_lost(
    number: int, at_ours: list[tuple[str, str]], at_peer: list[str]
) -> None:
    ours, peer, bus = both(block_size=2)
    bus.fate = lambda n, frame: LOST if n == number else GOOD
    ours.to_send.append(pattern(34))
    bus.run()
    assert (ours.failures, peer.errors) == (at_ours, at_peer)
    ours.to_send.append(pattern(300))
    bus.run()
    assert peer.received == [pattern(300)]


@pytest.mark.parametrize(
    ("number", "at_ours", "at_peer"),
    [
        (0, [], ["FlowControlTimeoutError"]),
        (1, [("ReceptionFailed", "TIMEOUT_CR")], ["FlowControlTimeoutError"]),
        (2, [("ReceptionFailed", "WRONG_SEQUENCE")], ["FlowControlTimeoutError"]),
        (3, [("ReceptionFailed", "TIMEOUT_CR")], ["FlowControlTimeoutError"]),
        (4, [("ReceptionFailed", "TIMEOUT_CR")], ["FlowControlTimeoutError"]),
        (5, [("ReceptionFailed", "WRONG_SEQUENCE")], []),
        (6, [("ReceptionFailed", "TIMEOUT_CR")], []),
    ],
)
def test_a_frame_of_the_peer_or_its_answer_is_lost(
    number: int, at_ours: list[tuple[str, str]], at_peer: list[str]
) -> None:
    ours, peer, bus = both(block_size=2)
    bus.fate = lambda n, frame: LOST if n == number else GOOD
    peer.send(pattern(34))
    bus.run()
    assert (ours.failures, peer.errors) == (at_ours, at_peer)
    peer.send(pattern(300))
    bus.run()
    assert ours.received == [pattern(300)]


def test_both_at_once() -> None:
    """Full duplex with blocks: the flow control of one direction between the frames of the other."""
    ours, peer, bus = both(block_size=4, separation_time_us=1_000)
    ours.to_send.extend([pattern(600), pattern(610)])
    peer.send(pattern(500))
    bus.run()
    assert ours.received == [pattern(500)]
    assert peer.received == [pattern(600), pattern(610)]
    kinds = [(wire.frame.identifier, wire.frame.data[0] >> 4) for wire in bus.log]
    assert {(0x58A, 2), (0x60A, 2)} <= {kind for pair in itertools.pairwise(kinds) for kind in pair}


def test_the_peer_runs_in_virtual_time() -> None:
    """Else the tests above would say nothing about separation: 127 ms between two frames, told exactly."""
    ours, peer, bus = both(separation_time_us=127_000)
    peer.send(pattern(20))
    bus.run()
    assert ours.received == [pattern(20)]
    ends = [wire.ended_ns for wire in bus.log if wire.frame.data[0] >> 4 == 2]
    assert 127 * MS - FRAME_NS <= ends[1] - ends[0] <= 127 * MS + FRAME_NS
    assert CLOCK.now_ns == bus.now_ns
