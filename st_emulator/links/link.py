"""What every link promises: bytes in, bytes out, never waiting."""

from types import TracebackType
from typing import Literal, Protocol, Self

LinkRole = Literal["unit", "obc"]


class LinkError(Exception):
    """A link cannot be opened or is gone; one line that names the link, what is wrong and what is allowed."""


class Link(Protocol):
    """A wire seen from one end.

    Reading and writing never wait. A byte that cannot be taken is lost and counted, as on a wire with no
    listener; nothing is queued beyond what the operating system holds. Safe to read in one thread and write
    in another.
    """

    name: str
    """What to print so that a person can find the other end."""
    dropped_bytes: int
    """Bytes given to `write` so far that were not taken."""

    def fileno(self) -> int | None:
        """File descriptor to select() on for reading, or None where there is none (then poll `read`)."""
        ...

    def read(self) -> bytes:
        """Every byte that has arrived, b"" when none. LinkError when the link is closed or has gone."""
        ...

    def write(self, data: bytes) -> int:
        """Number of leading bytes taken; the others are dropped and counted. LinkError: closed or gone."""
        ...

    def close(self) -> None:
        """Release the port. A second call does nothing."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...


class ClosesOnExit:
    """The context-manager half of a link."""

    def close(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
