"""ST[17] test."""

from __future__ import annotations

from ..messages import MessageDefinition, ServiceDefinition

SERVICE = ServiceDefinition(
    17,
    "Test",
    "6.17, 8.17",
    "Are you there?",
    (
        MessageDefinition(
            "TC",
            17,
            1,
            "ping",
            "Perform an are-you-alive connection test",
            "8.17.2.1",
            "Answered by a pong.",
            verification="completion at once",
        ),
        MessageDefinition(
            "TM", 17, 2, "pong", "Are-you-alive connection test report", "8.17.2.2", "The unit is there."
        ),
    ),
)
