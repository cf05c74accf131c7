"""Notifications to systemd: ready, stopping, alive (sd_notify, systemd 252)."""

import os
import socket


class ServiceManager:
    """The manager that started this process. Without one, or if it wants no notifications, nothing is sent."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._is_ready = False
        watchdog_us = os.environ.get("WATCHDOG_USEC", "")
        is_mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(watchdog_us) / 1e6 if watchdog_us.isdecimal() and is_mine else None
        """Time without progress after which the manager restarts this process [s]; None: never."""

    def ready(self, status: str) -> None:
        """Report that the start is complete."""
        self._is_ready = True
        self._send(f"READY=1\nSTATUS={status}")

    def stopping(self) -> None:
        """Report that the stop has begun."""
        self._send("STOPPING=1")

    def alive(self, status: str = "") -> None:
        """Report progress, once the start is complete: the first report starts the manager's clock."""
        if self._is_ready:
            self._send("WATCHDOG=1" + (f"\nSTATUS={status}" if status else ""), wait_s=0.0)

    def _send(self, text: str, wait_s: float = 1.0) -> None:
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            # A manager, or what passes it on from a container, may not read: then this process goes on without it.
            sender.settimeout(wait_s)
            try:
                sender.sendto(text.encode(), address)
            except OSError:
                return  # a manager that is gone cannot be notified
