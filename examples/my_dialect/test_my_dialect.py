"""My unit in virtual time, against octets made with struct alone. Run it with: python -m pytest"""

import binascii
import struct
from pathlib import Path

from st_emulator.bench.emulator import Emulator
from st_emulator.units.profile import load_unit

UNIT = load_unit(str(Path(__file__).with_name("my_unit.toml")))
MS = 1_000_000


def frame(number: int, payload: bytes = b"") -> bytes:
    body = struct.pack("<BBB", 7, number, len(payload)) + payload
    return b"\xa5\x5a" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def test_the_first_attitude_completes_the_command():
    sent = bytearray()
    emulator = Emulator(UNIT, transmit=lambda data, t_ns: sent.extend(data))
    emulator.advance(500 * MS)
    assert sent == frame(0x85, struct.pack("<H", 1))  # started, for the first time
    sent.clear()
    emulator.receive(b"noise" + frame(0x02))
    emulator.advance(510 * MS)
    assert sent == frame(0x81, b"\x02\x00")  # find_attitude: taken
    emulator.advance(1000 * MS)
    assert frame(0x82, b"\x02\x00") in sent  # done, no failure
