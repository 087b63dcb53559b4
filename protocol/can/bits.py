"""How many bits a CAN frame has on the wire, stuff bits included, and how long they take.

Frame formats, stuffing and CRC: ISO 11898-1:2015, 10.4 and 10.5. From start of frame to the end of the CRC
sequence (CAN FD: of the data field) a complementary bit follows five equal ones; the CRC field of CAN FD has
fixed stuff bits instead. The intermission is counted in, as the next frame cannot start before its end.
"""

from __future__ import annotations

from typing import NamedTuple

from ..durations import NS_PER_S
from ..errors import LocalProtocolError
from .frames import CAN_FD_LENGTHS, CanFrame

INTERMISSION_BITS = 3
END_OF_FRAME_BITS = 7
ACKNOWLEDGE_BITS = 2  # slot and delimiter
CRC_DELIMITER_BITS = 1
ERROR_FLAG_BITS = 6
ERROR_DELIMITER_BITS = 8
SUSPEND_TRANSMISSION_BITS = 8  # of an error passive node behind each frame that it sent
BUS_OFF_RECOVERY_BITS = 128 * 11  # occurrences of eleven recessive bits, if nobody sends

# ASSUMED: the flag of who sees an error first is answered by those of the others, the longest superposition.
ERROR_FRAME_BITS = 2 * ERROR_FLAG_BITS + ERROR_DELIMITER_BITS

_TAIL_BITS = ACKNOWLEDGE_BITS + END_OF_FRAME_BITS + INTERMISSION_BITS
_CRC_15_POLYNOMIAL = 0x4599
_STUFF_COUNT_BITS = 4
_DLC = {length: dlc for dlc, length in enumerate(CAN_FD_LENGTHS)}


class FrameBits(NamedTuple):
    """Bits at the nominal bit rate and at that of the data phase (0 without a switch of the bit rate).

    The rate switches at the sample points of BRS and of the CRC delimiter: the two parts of these bits add up
    to one bit of each rate wherever the sample points lie, so that BRS counts as nominal, the other as data.
    """

    nominal: int
    data_phase: int


def _crc_15_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = (crc << 1) ^ _CRC_15_POLYNOMIAL if crc & 0x4000 else crc << 1
        table.append(crc & 0x7FFF)
    return tuple(table)


# A state of the stuffing is the last bit and how often it has come, 1 to 5, in the bits 8 to 11: with 5 the
# stuff bit is due before the next bit. An entry has the state behind a byte and, from bit 12 on, the number
# of stuff bits inserted in it.
_FIRST_RUN = 1 << 8
_ONE = 8 << 8
_DUE = 5 << 8
_START = _ONE | _FIRST_RUN  # the idle bus is recessive


def _stuffing_table() -> tuple[int, ...]:
    def behind_bit(state: int, bit: int) -> tuple[int, int]:
        last, run, stuffed = state >> 11, (state >> 8) & 7, 0
        if run == 5:
            last, run, stuffed = 1 - last, 1, 1
        return ((last << 11) | ((run + 1) << 8) if bit == last else (bit << 11) | _FIRST_RUN), stuffed

    def behind_byte(state: int, byte: int) -> int:
        count = 0
        for shift in range(7, -1, -1):
            state, stuffed = behind_bit(state, (byte >> shift) & 1)
            count += stuffed
        return (count << 12) | state

    valid = {(last << 11) | (run << 8) for last in (0, 1) for run in range(1, 6)}
    return tuple(
        behind_byte(index & 0xF00, index & 0xFF) if index & 0xF00 in valid else 0 for index in range(4096)
    )


_CRC_15 = _crc_15_table()
_STUFFING = _stuffing_table()


def _stuff_bits(bits: int, count: int, *, end: bool) -> int:
    """Stuff bits among the first ``count`` bits of a frame; with ``end`` also one due behind the last."""
    padding = -count % 8
    bits |= (0x55 & ((1 << padding) - 1)) << count  # alternating, the last recessive: nothing is due in it
    state, stuffed = _START, 0
    for byte in bits.to_bytes((count + padding) // 8, "big"):
        entry = _STUFFING[state | byte]
        state = entry & 0xF00
        stuffed += entry >> 12
    return stuffed + (end and state & 0x700 == _DUE)


def _classic_bits(frame: CanFrame) -> FrameBits:
    dlc = frame.remote_dlc if frame.remote else len(frame.data)
    if frame.extended:  # SOF, 11, SRR, IDE, 18, RTR, FDF, r0, DLC
        bits = (frame.identifier >> 18) << 20 | 0b11 << 18 | frame.identifier & 0x3FFFF
        bits, count = bits << 7 | frame.remote << 6 | dlc, 39
    else:  # SOF, 11, RTR, IDE, FDF, DLC
        bits, count = frame.identifier << 7 | frame.remote << 6 | dlc, 19
    bits = bits << 8 * len(frame.data) | int.from_bytes(frame.data, "big")
    count += 8 * len(frame.data)
    crc = 0
    for byte in bits.to_bytes((count + 7) // 8, "big"):  # zeros before the first bit leave it at zero
        crc = (crc << 8) & 0x7FFF ^ _CRC_15[(crc >> 7) ^ byte]
    count += 15
    return FrameBits(
        count + _stuff_bits(bits << 15 | crc, count, end=True) + CRC_DELIMITER_BITS + _TAIL_BITS, 0
    )


def _fd_bits(frame: CanFrame) -> FrameBits:
    if frame.extended:  # SOF, 11, SRR, IDE, 18, RRS, FDF, res
        bits = (frame.identifier >> 18) << 20 | 0b11 << 18 | frame.identifier & 0x3FFFF
        bits, arbitration = bits << 3 | 0b010, 35
    else:  # SOF, 11, RRS, IDE, FDF, res
        bits, arbitration = frame.identifier << 4 | 0b0010, 16
    bits, arbitration = bits << 1 | frame.bit_rate_switch, arbitration + 1
    length = len(frame.data)
    whole = (bits << 1 | frame.error_state_indicator) << 4 | _DLC[length]
    whole = whole << 8 * length | int.from_bytes(frame.data, "big")
    count = arbitration + 5 + 8 * length
    # The fixed stuff bit at the start of the CRC field stands for one that is due behind the data.
    count += _stuff_bits(whole, count, end=False)
    crc_field = _STUFF_COUNT_BITS + (17 if length <= 16 else 21)
    total = count + crc_field + 1 + crc_field // 4 + CRC_DELIMITER_BITS + _TAIL_BITS
    if not frame.bit_rate_switch:
        return FrameBits(total, 0)
    nominal = arbitration + _stuff_bits(bits, arbitration, end=False) + _TAIL_BITS
    return FrameBits(nominal, total - nominal)


def frame_bits(frame: CanFrame) -> FrameBits:
    """The bits of ``frame`` from start of frame to the end of the intermission, with its stuff bits.

    Raises:
        LocalProtocolError: an error message of SocketCAN, which is no frame of the bus.
    """
    if frame.error:
        raise LocalProtocolError("CAN frame", "error", True, "a frame that is on the bus")
    return _fd_bits(frame) if frame.fd else _classic_bits(frame)


def bits_duration_ns(count: int, bitrate: int) -> int:
    """The time of ``count`` bits at ``bitrate`` (bit/s), rounded up to whole nanoseconds."""
    return -(-count * NS_PER_S // bitrate)


def frame_duration_ns(frame: CanFrame, bitrate: int, data_bitrate: int) -> int:
    """The time that ``frame`` takes on the bus, intermission included, rounded up to whole nanoseconds.
    ``bitrate`` and ``data_bitrate`` in bit/s; the latter counts for frames that switch the bit rate.
    """
    nominal, data_phase = frame_bits(frame)
    if not data_phase:
        return -(-nominal * NS_PER_S // bitrate)
    return -(-(nominal * data_bitrate + data_phase * bitrate) * NS_PER_S // (bitrate * data_bitrate))
