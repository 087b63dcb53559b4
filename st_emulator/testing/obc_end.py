"""An OBC in real time on a link of the operating system."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..obc import LiveReader, Obc, Recorder
from ..obc.connecting import connect_to
from ..units.profile import UnitProfile


def connected(
    link: str,
    profile: UnitProfile,
    node: int | None,
    listen: Callable[[LiveReader], None],
    recording: Path | None = None,
) -> Obc:
    """Join an OBC to a unit; ``listen`` is told its reader, ``recording`` a folder that it records into."""
    connection = connect_to(
        link,
        unit=profile.origin or profile.name,
        apid=profile.apid,
        source_id=profile.wire.source_id,
        node=node,
    )
    try:
        reader = LiveReader()
        obc = Obc(
            connection.link,
            apid=connection.apid,
            source_id=connection.source_id,
            recorder=None if recording is None else Recorder(recording),
            reader=reader,
            transport=connection.transport,
        )
    except BaseException:
        connection.link.close()
        raise
    listen(reader)
    return obc
