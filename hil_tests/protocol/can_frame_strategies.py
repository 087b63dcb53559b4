"""Strategies for CAN frames: what a bus carries, and error messages of SocketCAN."""

from __future__ import annotations

from hypothesis import strategies as st

from st_emulator.protocol.can.frames import CAN_FD_LENGTHS, CanFrame

# Runs of equal bits make stuff bits, which evenly drawn bytes seldom do.
DATA_BYTES = st.one_of(st.integers(0, 255), st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x83, 0xE0, 0x07]))


def data_of(length: int) -> st.SearchStrategy[bytes]:
    return st.lists(DATA_BYTES, min_size=length, max_size=length).map(bytes)


@st.composite
def bus_frames(draw: st.DrawFn) -> CanFrame:
    extended = draw(st.booleans())
    bits = 29 if extended else 11
    identifier = draw(st.one_of(st.integers(0, (1 << bits) - 1), st.sampled_from([0, (1 << bits) - 1])))
    kind = draw(st.sampled_from(["classic", "fd", "remote"]))
    if kind == "remote":
        return CanFrame(identifier, extended=extended, remote=True, remote_dlc=draw(st.integers(0, 8)))
    if kind == "fd":
        return CanFrame(
            identifier,
            draw(st.sampled_from(CAN_FD_LENGTHS).flatmap(data_of)),
            extended,
            fd=True,
            bit_rate_switch=draw(st.booleans()),
            error_state_indicator=draw(st.booleans()),
        )
    return CanFrame(identifier, draw(st.integers(0, 8).flatmap(data_of)), extended)


def error_messages() -> st.SearchStrategy[CanFrame]:
    return st.builds(CanFrame, st.integers(0, (1 << 29) - 1), data_of(8), error=st.just(True))


def frames() -> st.SearchStrategy[CanFrame]:
    return st.one_of(bus_frames(), error_messages())
