"""The communication objects, 1000h to 1FFFh, of a node of this card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from .data_types import DataType
from .emergency import HISTORY_ERRORS
from .objects import Access, DictionaryObject, Entry, record, variable
from .pdo import (
    COB_ID,
    EVENT_TIMER,
    INHIBIT_TIME,
    RECEIVE_MAPPING,
    RECEIVE_PARAMETERS,
    SYNC_START,
    TRANSMISSION_TYPE,
    TRANSMIT_MAPPING,
    TRANSMIT_PARAMETERS,
    mapped,
)

DEVICE_TYPE: Final = 0x1000
ERROR_REGISTER: Final = 0x1001
ERROR_HISTORY: Final = 0x1003
SYNC_COB_ID: Final = 0x1005
SYNC_PERIOD: Final = 0x1006
DEVICE_NAME: Final = 0x1008
HARDWARE_VERSION: Final = 0x1009
SOFTWARE_VERSION: Final = 0x100A
EMERGENCY_COB_ID: Final = 0x1014
EMERGENCY_INHIBIT_TIME: Final = 0x1015
HEARTBEAT_TIME: Final = 0x1017
IDENTITY: Final = 0x1018
SYNC_OVERFLOW: Final = 0x1019
SDO_SERVER: Final = 0x1200

EVENT_DRIVEN: Final = 0xFE

_U8, _U16, _U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
_CONST, _RO, _RW = Access.CONST, Access.READ_ONLY, Access.READ_WRITE


@dataclass(frozen=True)
class MappedObject:
    """An object in a PDO."""

    index: int
    sub: int
    bits: int


@dataclass(frozen=True)
class PdoDefinition:
    """A PDO of the card. ``base``: its identifier without the node's number; ``when``: for people."""

    number: int
    base: int
    mapping: tuple[MappedObject, ...]
    event_timer_ms: int
    when: str


def communication_objects(
    node: int,
    *,
    name: str,
    hardware_version: str,
    software_version: str,
    heartbeat_ms: int,
    receive: Sequence[tuple[PdoDefinition, int]],
    transmit: Sequence[tuple[PdoDefinition, int]],
    fixed_pdo_parameters: bool,
) -> list[DictionaryObject]:
    """The objects of a node; ``receive`` and ``transmit`` are its PDOs with their identifiers.

    ``fixed_pdo_parameters``: identifier, transmission type and inhibit time of a PDO cannot be written.
    """
    pdo_access = _CONST if fixed_pdo_parameters else _RW
    errors = [
        Entry(n, f"error_{n}", _U32, _RO, 0, "code, first two details") for n in range(1, 1 + HISTORY_ERRORS)
    ]
    objects = [
        variable(DEVICE_TYPE, "device_type", _U32, _RO, 0, "no device profile"),
        variable(ERROR_REGISTER, "error_register", _U8, _RO, 0, "bits of the errors that are there"),
        DictionaryObject(
            ERROR_HISTORY,
            "predefined_error_field",
            (Entry(0, "number_of_errors", _U8, _RW, 0, "0 is all that can be written: forget them"), *errors),
            "the newest first",
        ),
        variable(SYNC_COB_ID, "cob_id_sync", _U32, _RW, 0x80, "the card consumes SYNC"),
        variable(SYNC_PERIOD, "communication_cycle_period", _U32, _RW, 0, "kept, of no effect", unit="us"),
        variable(DEVICE_NAME, "manufacturer_device_name", DataType.VISIBLE_STRING, _CONST, name),
        variable(
            HARDWARE_VERSION,
            "manufacturer_hardware_version",
            DataType.VISIBLE_STRING,
            _CONST,
            hardware_version,
        ),
        variable(
            SOFTWARE_VERSION,
            "manufacturer_software_version",
            DataType.VISIBLE_STRING,
            _CONST,
            software_version,
        ),
        variable(
            EMERGENCY_COB_ID, "cob_id_emergency_message", _U32, _RW, 0x80 + node, "bit 31: none is sent"
        ),
        variable(EMERGENCY_INHIBIT_TIME, "inhibit_time_emcy", _U16, _RW, 0, "between two", unit="0.1 ms"),
        variable(HEARTBEAT_TIME, "producer_heartbeat_time", _U16, _RW, heartbeat_ms, "0: none", unit="ms"),
        record(
            IDENTITY,
            "identity",
            (
                Entry(1, "vendor_id", _U32, _RO, 0, "none"),
                Entry(2, "product_code", _U32, _RO, 0, "none"),
                Entry(3, "revision_number", _U32, _RO, 0, "none"),
                Entry(4, "serial_number", _U32, _RO, 0, "none"),
            ),
        ),
        variable(
            SYNC_OVERFLOW,
            "synchronous_counter_overflow_value",
            _U8,
            _RW,
            0,
            "0: SYNC comes without a counter; 2 to 240: with one, which is not looked at",
        ),
        record(
            SDO_SERVER,
            "sdo_server_parameter",
            (
                Entry(1, "cob_id_client_to_server", _U32, _RO, 0x600 + node),
                Entry(2, "cob_id_server_to_client", _U32, _RO, 0x580 + node),
                Entry(3, "node_id_od_sdo_client", _U8, _RO, 1, "the OBC"),
            ),
        ),
    ]
    for pdo, identifier in receive:
        objects += _pdo_objects(pdo, identifier, RECEIVE_PARAMETERS, RECEIVE_MAPPING, "rpdo", pdo_access)
    for pdo, identifier in transmit:
        objects += _pdo_objects(pdo, identifier, TRANSMIT_PARAMETERS, TRANSMIT_MAPPING, "tpdo", pdo_access)
    return objects


def _pdo_objects(
    pdo: PdoDefinition, identifier: int, parameters: int, mapping: int, kind: str, access: Access
) -> list[DictionaryObject]:
    transmit = kind == "tpdo"
    entries = [
        Entry(COB_ID, "cob_id", _U32, access, identifier, "bit 31: not valid"),
        Entry(TRANSMISSION_TYPE, "transmission_type", _U8, access, EVENT_DRIVEN, "0 to 240 and FEh, FFh"),
    ]
    if transmit:
        entries.append(Entry(INHIBIT_TIME, "inhibit_time", _U16, access, 0, "between two", unit="0.1 ms"))
        entries.append(Entry(EVENT_TIMER, "event_timer", _U16, _RW, pdo.event_timer_ms, "0: none", unit="ms"))
        entries.append(Entry(SYNC_START, "sync_start_value", _U8, _CONST, 0, "the counter is not looked at"))
    else:
        entries.append(
            Entry(EVENT_TIMER, "event_timer", _U16, _CONST, pdo.event_timer_ms, "not used", unit="ms")
        )
    items = [
        Entry(
            n,
            f"mapping_object_{n}",
            _U32,
            _CONST,
            mapped(item.index, item.sub, item.bits),
            "index, sub, bits",
        )
        for n, item in enumerate(pdo.mapping, start=1)
    ]
    return [
        record(parameters + pdo.number - 1, f"{kind}_{pdo.number}_communication_parameters", entries),
        record(mapping + pdo.number - 1, f"{kind}_{pdo.number}_mapping_parameters", items),
    ]
