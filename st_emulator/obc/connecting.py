"""From the text after `--link` and what is known of the unit to an open link and its transport."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..clock import NS_PER_MS
from ..errors import ConfigurationError
from ..links import Link, LinkSpecification, open_link, parse_link
from ..protocol.can.cyclic import NODES, CanIdentifiers
from ..protocol.errors import LocalProtocolError
from .can_transport import CanSettings, CanTransport
from .transport import SlipTransport, Transport

if TYPE_CHECKING:
    from ..units.profile import UnitProfile

DEFAULT_BAUD = 115_200


@dataclass(frozen=True)
class Connection:
    """An open link, its transport, and who talks to whom (apid None: to be learned)."""

    link: Link
    transport: Transport
    apid: int | None
    source_id: int


def connect_to(
    link: str,
    *,
    unit: str | None = None,
    apid: int | None = None,
    source_id: int | None = None,
    baud: int | None = None,
    node: int | None = None,
) -> Connection:
    """Open `link` as the OBC of a unit; what is not given comes from the unit's file, if `unit` names one.

    LinkError, or ConfigurationError for a unit or node that cannot be.
    """
    specification = parse_link(link)
    profile = None if unit is None else _profile(unit)
    if node is not None and specification.kind != "can":
        raise ConfigurationError(f"node {node}: only a CAN bus has node numbers, and the link is {link}")
    if profile is not None:
        if profile.wire.dialect != "pus":
            raise ConfigurationError(
                f"unit {unit}: speaks {profile.wire.dialect}; the OBC simulator speaks pus alone. "
                f"st-emulator demo --dialect {profile.wire.dialect} shows an exchange"
            )
        apid = profile.apid if apid is None else apid
        source_id = profile.wire.source_id if source_id is None else source_id
        baud = profile.wire.baud if baud is None else baud
    own = 0 if source_id is None else source_id
    if specification.kind == "can":
        bus = _can_transport(specification, profile, node)
        return Connection(open_link(specification, "obc", bitrate=bus.settings.bitrate), bus, apid, own)
    opened = open_link(specification, "obc", baud=DEFAULT_BAUD if baud is None else baud)
    return Connection(opened, SlipTransport(getattr(opened, "baud", None)), apid, own)


def _profile(unit: str) -> UnitProfile:
    from ..units.profile import load_unit  # pydantic costs a start that names no unit nothing

    return load_unit(unit)


def _can_transport(
    specification: LinkSpecification, profile: UnitProfile | None, node: int | None
) -> CanTransport:
    if profile is None:
        settings = CanSettings(fd=specification.fd)
        identifiers = None if node is None else _default_identifiers(node)
    else:
        can = profile.can
        settings = CanSettings(
            fd=specification.fd,
            padding=can.padding_byte,
            timeout_ns=can.timeout_ms * NS_PER_MS,
            bitrate=can.bitrate,
            data_bitrate=can.data_bitrate,
        )
        identifiers = can.identifier_table(node)
    if specification.bitrate is not None:
        faster = max(settings.data_bitrate, specification.bitrate)
        settings = replace(settings, bitrate=specification.bitrate, data_bitrate=faster)
    return CanTransport(identifiers, settings)


def _default_identifiers(node: int) -> CanIdentifiers:
    try:
        return CanIdentifiers(node)
    except LocalProtocolError:
        allowed = f"a whole number from {NODES[0]} to {NODES[-1]}"
        raise ConfigurationError(f"CAN node {node}: allowed is {allowed}") from None
