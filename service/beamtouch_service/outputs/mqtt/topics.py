"""The topics of a service. Pure."""

from dataclasses import dataclass

ONLINE, OFFLINE = "online", "offline"
"""What the status says: the service is connected to the broker, or not."""
READY = "ready"
"""What the status of a surface says when it has a contact to give."""


@dataclass(frozen=True)
class Topics:
    """The topics below one prefix."""

    prefix: str

    @property
    def status(self) -> str:
        """Of the service; the broker keeps its last message."""
        return f"{self.prefix}/status"

    def surface_status(self, surface: str) -> str:
        """Of the status of a surface; the broker keeps its last message."""
        return f"{self.prefix}/{surface}/status"

    def contact(self, surface: str) -> str:
        """Of the contacts on a surface."""
        return f"{self.prefix}/{surface}/contact"

    def event(self, surface: str) -> str:
        """Of the finished events of a surface."""
        return f"{self.prefix}/{surface}/event"
