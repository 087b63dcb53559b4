"""The unmodified package ``canopen`` as master, without a socket: it and the unit share virtual time."""

from __future__ import annotations

import io
import queue
import struct

import canopen
import pytest
from canopen.sdo import SdoAbortedError, SdoCommunicationError
from oresat_configs import OreSatConfig
from PIL import Image

from hil_tests.dialects.canopen.bench import START_UNIX_S, Bench, make
from hil_tests.dialects.canopen.client import STATES, scet

STEP_MS = 1
MOST_STEPS = 3000


class Answers(queue.Queue):
    """What the client waits on: virtual time goes on until there is something."""

    def __init__(self, bench: Bench) -> None:
        super().__init__()
        self.bench = bench

    def get(self, block: bool = True, timeout: float | None = None) -> bytes:
        for _ in range(round((timeout or 0) * 1000 / STEP_MS)):
            if not self.empty():
                break
            self.bench.run(STEP_MS)
        return super().get(block=False)


class Network(canopen.Network):
    """Frames go to the unit, and the unit's come here, at virtual times."""

    def __init__(self, bench: Bench) -> None:
        super().__init__()
        self.bench = bench
        bench.hear = self._hear

    def _hear(self, t_ns: int, identifier: int, payload: bytes) -> None:
        self.notify(identifier, bytearray(payload), t_ns / 1e9)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.bench.put(can_id, bytes(data), remote=remote)


@pytest.fixture(scope="module")
def dictionary() -> canopen.ObjectDictionary:
    return OreSatConfig("oresat1").od_db["star_tracker_1"]


def joined(bench: Bench, dictionary: canopen.ObjectDictionary) -> canopen.RemoteNode:
    network = Network(bench)
    node = canopen.RemoteNode(0x2C, dictionary)
    network.add_node(node)
    # A new queue is made where one holds old answers: it has to be of this kind, too.
    node.sdo.responses = Answers(bench)
    request_response = node.sdo.request_response

    def ask(request: bytes) -> bytes:
        node.sdo.responses = Answers(bench)
        return request_response(request)

    node.sdo.request_response = ask
    return node


@pytest.fixture
def bench() -> Bench:
    return make().boot()


@pytest.fixture
def node(bench, dictionary) -> canopen.RemoteNode:
    return joined(bench, dictionary)


def test_boot_up_and_heartbeat(dictionary):
    bench = make()
    node = joined(bench, dictionary)
    seen = []
    node.nmt.add_heartbeat_callback(seen.append)
    bench.run(1600)
    assert seen == [0, 5]
    assert node.nmt.state == "OPERATIONAL"


def test_network_management(bench, node):
    seen = []
    node.nmt.add_heartbeat_callback(seen.append)
    node.sdo["producer_heartbeat_time"].raw = 50
    for state, number in (("PRE-OPERATIONAL", 127), ("STOPPED", 4), ("OPERATIONAL", 5)):
        node.nmt.state = state
        bench.run(60)
        assert seen[-1] == number
    node.nmt.state = "RESET COMMUNICATION"
    bench.run(3)
    assert seen[-1] == 0


OURS_ALONE = {0x1008, 0x1009, 0x100A}
#: Objects of files, updater, logs, daemons and operating system, which the device has not.
NOT_HERE = {0x1023, 0x3007}
PARTLY_HERE = {0x3003, 0x3004, 0x3005, 0x3006}


def test_the_dictionary_is_that_of_the_card(bench, node, dictionary):
    """Every object of the card is there with the same type, access and default, and nothing but those."""
    ours = bench.emulator.dialect.dictionary.objects
    access = {"const": "ro", "ro": "ro", "rw": "rw", "wo": "wo"}
    for index, theirs in dictionary.items():
        if index in NOT_HERE:
            assert index not in ours
            continue
        variables = [theirs] if isinstance(theirs, canopen.objectdictionary.ODVariable) else theirs.values()
        for variable in variables:
            entry = ours[index].subs.get(variable.subindex)
            if entry is None:
                assert index in PARTLY_HERE, f"{index:04X}h:{variable.subindex}"
                continue
            where = f"{index:04X}h:{variable.subindex}"
            if variable.subindex == 0 and len(ours[index].subs) > 1:
                continue  # ours: how many there are
            assert entry.type == variable.data_type, where
            assert access[entry.access.value] == access[variable.access_type], where
            if index != 0x1200 and entry.type != 0x0F:  # 1200h holds the channel's identifiers here
                assert entry.default == variable.default, where
            if index >= 0x2000:
                assert entry.name == (theirs.name if variable is theirs else variable.name), where
    assert set(ours) - set(dictionary) == OURS_ALONE
    subs = {(index, sub) for index, item in ours.items() if index >= 0x2000 for sub in item.subs}
    their_subs = {
        (index, sub)
        for index, item in dictionary.items()
        for sub in (item.subindices if hasattr(item, "subindices") else {0: item})
    }
    assert subs <= their_subs


def test_every_object_can_be_read(node, dictionary, bench):
    read = 0
    for index, item in bench.emulator.dialect.dictionary.objects.items():
        for sub, entry in item.subs.items():
            if entry.access.value == "wo" or (index == 0x1003 and sub):
                with pytest.raises(SdoAbortedError):
                    node.sdo.upload(index, sub)
            else:
                node.sdo.upload(index, sub)
                read += 1
    assert read > 90


def test_values_by_name(node, bench):
    assert node.sdo["status"].raw == STATES["STANDBY"]
    node.sdo["capture"]["delay"].raw = 250
    assert node.sdo["capture"]["delay"].raw == 250
    assert node.sdo["satellite_id"].raw == 3
    assert node.sdo["versions"]["configs_version"].raw == "1.2.0"
    assert node.sdo["orientation"]["attitude_real"].raw == 0.0
    node.sdo["scet"].raw = int.from_bytes(scet(START_UNIX_S), "little")  # segmented: 8 octets
    bench.run(260)
    assert node.sdo["system"]["unix_time"].raw == START_UNIX_S


def test_aborts(node):
    for index, sub, code in ((0x2222, 0, 0x06020000), (0x1018, 7, 0x06090011), (0x3003, 1, 0x06010001)):
        with pytest.raises(SdoAbortedError) as error:
            node.sdo.upload(index, sub)
        assert error.value.code == code
    with pytest.raises(SdoAbortedError) as error:
        node.sdo.download(0x1017, 0, bytes(4))
    assert error.value.code == 0x06070012


def test_the_pdos_as_the_package_reads_them(node, bench):
    node.tpdo.read()
    node.rpdo.read()
    assert node.tpdo[3].cob_id == 0x3AC
    assert node.tpdo[5].cob_id == 0x1AD
    assert node.rpdo[1].cob_id == 0x181
    assert [variable.name for variable in node.tpdo[4].map] == [
        "orientation.attitude_real",
        "orientation.attitude_i",
    ]
    got = []
    for number in (3, 4, 5):
        node.tpdo[number].add_callback(lambda pdo: got.append((pdo.cob_id, [v.raw for v in pdo.map])))
    node.sdo["status"].raw = STATES["STAR_TRACK"]
    bench.run(1000)
    assert [identifier for identifier, _ in got[:3]] == [0x3AC, 0x4AC, 0x1AD]
    assert got[0][1][:2] == [STATES["STAR_TRACK"], True]
    real, i = got[1][1]
    j, k = got[2][1]
    assert real**2 + i**2 + j**2 + k**2 == pytest.approx(1, abs=1e-6)


def test_the_time_by_rpdo_and_sync(node, bench):
    node.rpdo.read()
    node.rpdo[1]["scet"].raw = int.from_bytes(scet(START_UNIX_S), "little")
    node.rpdo[1].transmit()
    node.network.sync.transmit()
    bench.run(260)
    assert node.sdo["system"]["unix_time"].raw == START_UNIX_S


def test_emergencies(node, bench):
    node.network.send_message(0x181, b"\0")
    bench.run(5)
    (error,) = node.emcy.log
    assert (error.code, error.register) == (0x8210, 0x11)
    assert node.sdo[0x1003][1].raw == 0x01018210


def track(node, bench):
    node.sdo["status"].raw = STATES["STAR_TRACK"]
    bench.run(700)
    node.sdo["status"].raw = STATES["STANDBY"]


def test_the_display_image_by_segments_and_by_blocks(node, bench):
    record = node.sdo["capture"]
    assert record["last_display_image"].raw in (b"", "")
    track(node, bench)
    with node.sdo.open(0x4001, 5, block_transfer=True, buffering=7) as stream:
        by_blocks = stream.read()
    picture = Image.open(io.BytesIO(by_blocks))
    picture.load()
    assert picture.format == "PNG"
    assert picture.size == (640, 408)  # 752 x 480 reduced by 640 / 752
    with node.sdo.open(0x4001, 5, block_transfer=True, buffering=7, request_crc_support=False) as stream:
        assert stream.read() == by_blocks
    by_segments = node.sdo.upload(0x4001, 5)
    assert by_segments == by_blocks


def test_the_raw_image_is_what_the_sensor_gave(node, bench):
    bench.ask_for("CAPTURE")
    bench.run(1100)
    pixels = bench.emulator.device.image_memory.image.pixels.full()
    rows, columns = pixels.shape
    assert (columns, rows) == (752, 480)
    with node.sdo.open(0x4001, 4, block_transfer=True, buffering=0) as stream:
        assert stream.size == 2 * rows * columns
        raw = b"".join(stream.read(7) for _ in range(1270))  # ten blocks; all of it takes 13 s of bus
        node.sdo.abort()
    assert struct.unpack(f"<{len(raw) // 2}H", raw) == tuple(pixels.flat[: len(raw) // 2])


def test_block_download(node, bench):
    data = scet(START_UNIX_S)
    with node.sdo.open(0x2010, 0, "wb", block_transfer=True, buffering=7, size=8) as stream:
        stream.write(data)
    bench.run(260)
    assert node.sdo["system"]["unix_time"].raw == START_UNIX_S


def test_a_transfer_that_the_client_gives_up(node, bench):
    stream = node.sdo.open(0x1008, 0, buffering=0)
    node.sdo.abort()
    bench.run(5)
    with pytest.raises((SdoAbortedError, SdoCommunicationError)):
        stream.read(7)
    assert node.sdo["status"].raw == STATES["STANDBY"]
