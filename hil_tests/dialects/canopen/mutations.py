"""Good traffic, spoilt: frames flipped, cut, lengthened, mixed, of other identifiers or of chance."""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass

from hil_tests.dialects.canopen import client
from hil_tests.dialects.canopen.bench import make

CHECK_EVERY = 100  # frames


@dataclass(frozen=True)
class Report:
    """``frames`` that went in, frames ``sent`` by the unit, ``checks`` of a good command that were answered,
    ``resets``: power cycles of a unit that was told to go down."""

    frames: int
    sent: int
    checks: int
    resets: int


def good_traffic() -> list[tuple[int, bytes]]:
    """Frames of transfers of every kind, of PDOs, SYNC and network management."""
    sdo = 0x62C
    name, image, time = (client.place(*one) for one in ((0x1008, 0), (0x4001, 5), (0x2010, 0)))
    status, heartbeat = client.place(0x4000, 0), client.place(0x1017, 0)
    frames = [
        (sdo, b"\x40" + name), (sdo, b"\x60"), (sdo, b"\x70"),
        (sdo, b"\x40" + status), (sdo, b"\x40" + client.place(0x1003, 0)),
        *((sdo, b"\x2f" + status + bytes((state,))) for state in (2, 3, 4, 5, 2)),
        (sdo, b"\x2b" + heartbeat + struct.pack("<H", 1000)),
        (sdo, b"\x21" + time + struct.pack("<I", 8)), (sdo, b"\x00" + bytes(7)), (sdo, b"\x1d\x00"),
        (sdo, b"\xa4" + name + b"\x7f\x00"), (sdo, b"\xa3"), (sdo, b"\xa2\x01\x7f"), (sdo, b"\xa1"),
        (sdo, b"\xa4" + image + b"\x04\x00"), (sdo, b"\xa3"), (sdo, b"\xa2\x04\x04"), (sdo, b"\xa2\x02\x04"),
        (sdo, b"\xc6" + time + struct.pack("<I", 8)), (sdo, b"\x01" + bytes(7)), (sdo, b"\x82" + bytes(7)),
        (sdo, b"\xd9" + struct.pack("<H", client.crc16(bytes(8)))),
        (sdo, b"\x80" + name + bytes(4)),
        (0x181, client.scet(1_768_435_200)), (0x80, b""),
        (0, b"\x01\x2c"), (0, b"\x80\x2c"), (0, b"\x02\x2c"), (0, b"\x01\x00"),
    ]  # fmt: skip
    return [(identifier, data.ljust(8, b"\0") if identifier == sdo else data) for identifier, data in frames]


def spoilt(chance: random.Random, frame: tuple[int, bytes], other: tuple[int, bytes]) -> bytes:
    """A frame's record with something wrong, or not."""
    identifier, data = frame
    octets = bytearray(data)
    match chance.randrange(12):
        case 0 if octets:
            octets[chance.randrange(len(octets))] ^= 1 << chance.randrange(8)
        case 1:
            octets = octets[: chance.randrange(len(octets) + 1)]
        case 2 if len(octets) < 8:
            octets += chance.randbytes(8 - len(octets))
        case 3:
            identifier ^= 1 << chance.randrange(11)
        case 4:
            octets[:4] = other[1][:4]
        case 5:
            octets = bytearray(chance.randbytes(chance.randrange(9)))
        case 6:
            identifier, octets = chance.randrange(0x800), bytearray(chance.randbytes(8))
        case 7:
            return client.record(identifier, bytes(octets), extended=True)
        case 8:
            return client.record(identifier, b"", remote=True)
        case 9:
            whole = bytearray(client.record(identifier, bytes(octets)))
            whole[chance.randrange(len(whole))] ^= 1 << chance.randrange(8)
            return bytes(whole)
        case 10 if len(octets) == 8:
            octets[1:4] = chance.choice(
                (b"\x03\x30\x01", b"\x01\x40\x02", b"\x02\x18\x05", chance.randbytes(3))
            )
        case _:
            pass
    return client.record(identifier, bytes(octets))


def mutate(count: int, seed: int) -> Report:
    """Feed ``count`` frames to a running unit; raises what the unit raises, or AssertionError when a good
    command is not answered behind them.
    """
    chance = random.Random(seed)
    bench = make(seed=seed, heartbeat_ms=0).boot()
    traffic = good_traffic()
    sent = checks = resets = fed = 0
    device = bench.emulator.device
    while fed < count:
        batch = b""
        for _ in range(min(chance.randrange(1, 40), count - fed)):
            number = chance.randrange(len(traffic))
            batch += spoilt(chance, traffic[number], chance.choice(traffic))
            fed += 1
        bench.emulator.receive(batch)
        bench.run(chance.choice((0.2, 1, 3, 8)))
        if fed // CHECK_EVERY == checks and fed < count:
            continue
        checks = max(fed // CHECK_EVERY, 1)
        sent += len(bench.sent)
        bench.run(20)
        if not device.listening:  # something asked for a reset or for power to go
            resets += 1
            device.power_off()
            device.power_on()
            bench.run(bench.emulator.profile.timing.boot_ms + 5)
        bench.put(0, b"\x01\x2c")
        bench.put(0x62C, b"\x80" + bytes(7))
        bench.put(0x80)
        bench.run(5)
        bench.forget()
        answers = bench.exchange(b"\x40" + client.place(0x1018, 0) + bytes(4))
        assert bytes.fromhex("4f 1810 00 04 000000") in answers, (fed, [one.hex() for one in answers])
        if chance.randrange(4):
            bench.ask_for("STANDBY")
        bench.forget()
    return Report(fed, sent, checks, resets)
