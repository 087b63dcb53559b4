"""What defines a message, and the table that holds every message."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import construct

from .fields import DataLayout, Element

Kind = Literal["TC", "TM"]


@dataclass(frozen=True)
class ServiceDefinition:
    """A PUS service: its number, title, clause of ECSS-E-ST-70-41C ("" when mission-specific) and
    messages.
    """

    number: int
    title: str
    clause: str
    description: str
    messages: tuple[MessageDefinition, ...]


@dataclass(frozen=True)
class MessageDefinition:
    """One telecommand or telemetry message.

    ``fields`` describe its application (TC) or source (TM) data in the order of the wire. ``clause`` is
    that of ECSS-E-ST-70-41C; ``tailoring`` says where this interface departs from it. ``verification`` says
    which reports a telecommand gives beyond acceptance, ``when`` what sends a telemetry message. Messages
    grow at their end: ``earlier_ends`` names the last field of each earlier edition, which is still read.
    """

    kind: Kind
    service: int
    subservice: int
    name: str
    title: str
    clause: str
    description: str
    fields: tuple[Element, ...] = ()
    tailoring: str = ""
    verification: str = ""
    notes: tuple[str, ...] = ()
    earlier_ends: tuple[str, ...] = ()

    @cached_property
    def data(self) -> DataLayout:
        """Codec and checks of its application or source data."""
        return DataLayout(self.fields, self.earlier_ends)

    @property
    def layout(self) -> construct.Construct:
        """The construct of its application or source data."""
        return self.data.construct

    @property
    def label(self) -> str:
        """As the standard writes it: ``TC[8,1]``."""
        return f"{self.kind}[{self.service},{self.subservice}]"


class MessageRegistry:
    """Every message of the interface, in the order of the services.

    Names are unique over telecommands and telemetry. Building one with a name or type twice is a ValueError.
    """

    def __init__(self, services: Iterable[ServiceDefinition]) -> None:
        self.services = tuple(services)
        self._by_name: dict[str, MessageDefinition] = {}
        self._by_type: dict[tuple[str, int, int], MessageDefinition] = {}
        self._numbers: dict[str, set[int]] = {"TC": set(), "TM": set()}
        for message in (message for service in self.services for message in service.messages):
            key = (message.kind, message.service, message.subservice)
            if message.name in self._by_name or key in self._by_type:
                raise ValueError(f"{message.label} {message.name} is defined twice")
            self._by_name[message.name] = message
            self._by_type[key] = message
            self._numbers[message.kind].add(message.service)

    def __iter__(self) -> Iterator[MessageDefinition]:
        return iter(self._by_name.values())

    def __len__(self) -> int:
        return len(self._by_name)

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def by_name(self, name: str) -> MessageDefinition:
        """The message of this name; KeyError when there is none."""
        return self._by_name[name]

    def by_type(self, kind: Kind, service: int, subservice: int) -> MessageDefinition | None:
        """The message of this kind, service and subservice, None when there is none."""
        return self._by_type.get((kind, service, subservice))

    def has_service(self, kind: Kind, service: int) -> bool:
        """Whether any message of this kind belongs to the service."""
        return service in self._numbers[kind]

    def telecommands(self) -> list[MessageDefinition]:
        """All telecommands."""
        return [message for message in self if message.kind == "TC"]

    def telemetry(self) -> list[MessageDefinition]:
        """All telemetry messages."""
        return [message for message in self if message.kind == "TM"]
