"""Where bytes enter and leave: memory, pseudo-terminals, serial ports. Nothing else touches a port."""

from .link import Link, LinkError, LinkRole
from .memory import MemoryLink, NullLink, memory_link_pair
from .opening import open_link
from .specification import LinkSpecification, parse_link

__all__ = [
    "Link",
    "LinkError",
    "LinkRole",
    "LinkSpecification",
    "MemoryLink",
    "NullLink",
    "memory_link_pair",
    "open_link",
    "parse_link",
]
