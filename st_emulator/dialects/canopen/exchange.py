"""The scripted exchange of the demo: an OBC that meets the card, in the order of a first day."""

from __future__ import annotations

import math
import struct
from statistics import median

from ...clock import NS_PER_MS
from ...protocol.can.frames import CanFrame, RecordDecoder, encode_record
from ...protocol.canopen import card
from ...protocol.canopen.card import CardState
from ...protocol.canopen.communication import DEVICE_NAME
from ...protocol.canopen.node import HEARTBEAT, SDO_TO_CLIENT, SDO_TO_SERVER
from ...protocol.canopen.time_codes import scet_of
from ...protocol.canopen.transfers import crc16
from ...units.validation import validate
from ..dialect import DemoSession
from .settings import CanopenSettings
from .telecommands import download, encode_named, upload

START_UTC = "2026-01-15T00:00:00+00:00"  # virtual time zero of a scenario that does not say otherwise
START_UNIX_US = 1_768_435_200_000_000
STEP_MS = 2.0
WATCH_MS = 3000.0
GENERAL_ERROR = bytes.fromhex("00000008")  # 08000000h, the OBC's abort of a transfer it has seen enough of
MS_FOR_ANSWER = 100.0
ARCSEC = math.degrees(1) * 3600

Frames = list[tuple[int, CanFrame]]


class Master:
    """The OBC: what it puts on the bus, and the card's frames."""

    def __init__(self, session: DemoSession) -> None:
        given = session.profile.dialects.get("canopen", {})
        self.settings = validate(CanopenSettings, given, "dialects.canopen")
        self.session = session
        self.node = self.settings.node
        self._decoder = RecordDecoder()
        self._unread: Frames = []

    def run(self, ms: float) -> Frames:
        """Let time go on: (virtual time, frame) of what the card sent."""
        return [
            (t_ns, frame) for t_ns, record in self.session.run(ms) for frame in self._decoder.receive(record)
        ]

    def await_frame(self, identifier: int, within_ms: float) -> CanFrame | None:
        """The next frame of an identifier."""
        for _ in range(1 + math.ceil(within_ms / STEP_MS)):
            for number, (_, frame) in enumerate(self._unread):
                if frame.identifier == identifier:
                    del self._unread[: number + 1]
                    return frame
            self._unread = self.run(STEP_MS)
        return None

    def ask(self, records: bytes) -> bytes:
        """A frame of SDO and the card's answer; empty when there is none."""
        self.session.put(records)
        answer = self.await_frame(SDO_TO_CLIENT + self.node, MS_FOR_ANSWER)
        return b"" if answer is None else answer.data

    def read(self, index: int, sub: int) -> bytes:
        """An object by expedited or segmented upload."""
        answer = self.ask(upload(self.node, index, sub))
        if not answer or answer[0] >> 5 != 2:
            return b""
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        data, toggle = b"", 0
        while True:
            answer = self.ask(self._frame(bytes((0x60 | toggle,))))
            if not answer or answer[0] >> 5:
                return data
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            if answer[0] & 1:
                return data
            toggle ^= 0x10

    def read_by_blocks(self, index: int, sub: int, block: int, most_blocks: int | None = None) -> bytes:
        """An object by block upload, its CRC checked; or its first blocks alone, and an abort. Empty when the
        card does not answer as it should."""
        place = index.to_bytes(2, "little") + bytes((sub,))
        answer = self.ask(self._frame(b"\xa4" + place + bytes((block, 0))))
        if not answer or answer[0] >> 5 != 6:
            return b""
        size, data, blocks = int.from_bytes(answer[4:], "little"), b"", 0
        self.session.put(self._frame(b"\xa3"))
        while True:
            segments: list[bytes] = []
            while len(segments) < block and not (segments and segments[-1][0] & 0x80):
                segment = self.await_frame(SDO_TO_CLIENT + self.node, MS_FOR_ANSWER)
                if segment is None:
                    return b""
                segments.append(segment.data)
            data += b"".join(one[1:] for one in segments)
            blocks += 1
            acknowledgement = self._frame(bytes((0xA2, len(segments), block)))
            if segments[-1][0] & 0x80:
                break
            if blocks == most_blocks:
                self.session.put(self._frame(b"\x80" + place + GENERAL_ERROR))
                return data
            self.session.put(acknowledgement)
        end, whole = self.ask(acknowledgement), data[:size]
        self.session.put(self._frame(b"\xa1"))
        right = end[:1] and end[0] & 0xE3 == 0xC1 and crc16(whole) == int.from_bytes(end[1:3], "little")
        return whole if right else b""

    def _frame(self, data: bytes) -> bytes:
        return encode_record(CanFrame(SDO_TO_SERVER + self.node, data.ljust(8, b"\0")))

    def command(self, name: str, **fields: object) -> bytes:
        """The records of a telecommand by name."""
        return encode_named(self.node, self.settings, name, fields)


def boresight_error_arcsec(
    measured: tuple[float, float, float, float], true: tuple[float, float, float, float]
) -> float:
    """Angle between the boresights (+Z) of two attitudes that turn ICRS to sensor components."""

    def boresight(q: tuple[float, float, float, float]) -> tuple[float, float, float]:
        x, y, z, w = q
        return (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))

    a, b = boresight(measured), boresight(true)
    # Of small angles the cosine says nothing: by the chord.
    return 2 * math.asin(min(1.0, math.dist(a, b) / 2)) * ARCSEC


def exchange(session: DemoSession) -> None:
    """Boot-up, identity, time, star tracking, an image, standby."""
    master = Master(session)
    profile, node = session.profile, master.node
    session.say(f"card {node:02X}h: power is on, nothing is heard while it boots")
    boot_up = master.await_frame(HEARTBEAT + node, profile.timing.boot_ms + MS_FOR_ANSWER)
    said = b"" if boot_up is None else boot_up.data
    session.say(f"  {HEARTBEAT + node:03X}#{said.hex()}  boot-up message")
    session.check("boot-up messages", float(said == b"\0"), "==", 1.0, "")
    heartbeat = master.await_frame(HEARTBEAT + node, master.settings.heartbeat_ms + MS_FOR_ANSWER)
    said = b"" if heartbeat is None else heartbeat.data
    session.say(f"  {HEARTBEAT + node:03X}#{said.hex()}  heartbeat: 05 operational, 7f pre-operational")
    name = master.read(DEVICE_NAME, 0).decode("ascii", "replace")
    session.say(f"object 1008h by segments: the card says it is {name!r}")
    session.check("name of the card", float(name == profile.unit.name), "==", 1.0, "")
    again = master.read_by_blocks(DEVICE_NAME, 0, block=127).decode("ascii", "replace")
    session.say(f"the same by blocks, with a CRC: {again!r}")
    session.check("the same by blocks", float(again == name), "==", 1.0, "")
    unix_us = START_UNIX_US + session.now_ns // 1000
    session.put(
        encode_record(CanFrame(0x180 + master.settings.obc_node, scet_of(unix_us).to_bytes(8, "little")))
    )
    session.say(f"the time to all cards by RPDO 1: {START_UTC} and {session.now_ns / 1e9:.3f} s")
    _watch(master)
    _picture(master)
    answer = master.ask(download(node, card.STATUS, 0, bytes((CardState.BOOT,))))
    state = master.read(card.STATUS, 0)
    session.say(f"status <- BOOT, which cannot follow: answer {answer[:1].hex()}, state stays {state.hex()}")
    master.ask(master.command("status", state="STANDBY"))
    state = master.read(card.STATUS, 0)
    session.check("state in the end", float(state[0]) if state else -1.0, "==", float(CardState.STANDBY), "")


def _watch(master: Master) -> None:
    """Star tracking, and the attitudes of TPDO 3 to 5 against the truth."""
    session, node = master.session, master.node
    master.ask(master.command("status", state="STAR_TRACK"))
    session.say("status <- STAR_TRACK; TPDO 3, 4 and 5 of each solved image:")
    timing = session.profile.timing
    period_ns = session.profile.frame_period_ns
    settled_ns = round((timing.exposure_ms + timing.readout_ms) * NS_PER_MS)
    parts: dict[int, bytes] = {}
    errors: list[float] = []
    for t_ns, frame in master.run(WATCH_MS):
        parts[frame.identifier] = frame.data
        if frame.identifier != 0x181 + node or not {0x380 + node, 0x480 + node} <= parts.keys():
            continue
        real, i = struct.unpack("<ff", parts[0x480 + node])
        j, k = struct.unpack("<ff", frame.data)
        started_ns = (t_ns - settled_ns) // period_ns * period_ns
        middle_ns = (
            started_ns + round(timing.exposure_ms * NS_PER_MS + session.profile.last_row_start_ns) // 2
        )
        errors.append(boresight_error_arcsec((i, j, k, real), session.true_quaternion(middle_ns)))
        if len(errors) <= 3:
            session.say(f"  {t_ns / 1e9:8.3f} s  i {i:+.7f}  j {j:+.7f}  k {k:+.7f}  real {real:+.7f}")
    session.say(f"  {len(errors)} attitudes in {WATCH_MS / 1000:g} s")
    session.check("attitudes", float(len(errors)), ">=", WATCH_MS * NS_PER_MS / period_ns / 2, "")
    limit = session.profile.requirements.cross_boresight_arcsec or session.profile.pixel_arcsec
    comparable = (master.settings.boresight, master.settings.direction) == ("z", "icrs_to_sensor")
    if errors and comparable:
        # The first are solved before the time is in force, which corrects aberration.
        session.check("boresight error, median", median(errors[2:] or errors), "<=", limit, "arcsec")


def _picture(master: Master) -> None:
    """The beginning of the display image by block upload: its signature and its size."""
    beginning = master.read_by_blocks(card.CAPTURE, card.LAST_DISPLAY_IMAGE, block=4, most_blocks=1)
    is_png = beginning.startswith(b"\x89PNG\r\n\x1a\n")
    columns, rows = struct.unpack(">II", beginning[16:24]) if is_png else (0, 0)
    master.session.say(f"last_display_image, its first block: a PNG of {columns} x {rows} px")
    master.session.check("image is a PNG", float(is_png), "==", 1.0, "")
    master.session.check("image columns", float(columns), "<=", float(card.DISPLAY_COLUMNS), "px")
