"""From a link as asked for to an open link."""

from .link import Link, LinkError, LinkRole
from .memory import NullLink
from .specification import LinkSpecification, parse_link

DEFAULT_BAUD = 115_200
DEFAULT_BITRATE = 1_000_000


def open_link(
    specification: LinkSpecification | str,
    role: LinkRole = "unit",
    baud: int = DEFAULT_BAUD,
    default_name: str = "unit",
    bitrate: int = DEFAULT_BITRATE,
) -> Link:
    """Open a link as the unit, which creates a pseudo-terminal, or as the OBC, which opens one.

    baud: line rate where the specification names none; bitrate: nominal bit rate of a CAN bus likewise, in
    bit/s. default_name: name of the pseudo-terminal's link in the runtime folder when the specification has
    no path (the unit's name); an OBC that finds no such name takes the only one that is live. A CAN bus is
    the same to both and gives a `can.bus.CanLink`. Raises LinkError.
    """
    if isinstance(specification, str):
        specification = parse_link(specification)
    if specification.kind == "none":
        return NullLink()
    # The port libraries are loaded only when a port is asked for.
    if specification.kind == "can":
        from .can import bus

        assert specification.interface is not None  # parse_link gives no CAN bus without both
        assert specification.path is not None
        return bus.CanLink(
            specification.interface, specification.path, specification.bitrate or bitrate, specification.fd
        )
    from . import pty, serial_port

    if specification.kind == "serial":
        assert specification.path is not None  # parse_link gives no serial port without a device
        return serial_port.SerialLink(specification.path, specification.baud or baud)
    if role == "unit":
        return pty.PtyLink(specification.path or pty.default_path(default_name))
    path = specification.path or pty.only_live_path(default_name)
    if not pty.is_terminal(path):
        raise LinkError(
            f"pty:{path}: no pseudo-terminal there; start the emulator with --link pty:{path} first"
        )
    return serial_port.SerialLink(path, baud)
