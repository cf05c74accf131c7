"""A service manager, as far as a program that notifies it can tell."""

import socket
import time
from pathlib import Path


class Manager:
    """Hears what programs notify it of."""

    def __init__(self, folder: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / "notify"))
        self._socket.settimeout(0.1)
        of_manager = {"NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "400000"}
        self.code = f"import os; os.environ.update({of_manager})"
        """Code of a program that is to notify it, with a watchdog of 0.4 s."""
        self.heard: list[str] = []

    def until(self, word: str, times: int = 1, within_s: float = 60) -> bool:
        """Listen until a word was heard so many times more; returns whether it was."""
        deadline_s = time.monotonic() + within_s
        while times and time.monotonic() < deadline_s:
            try:
                lines = self._socket.recv(4096).decode().splitlines()
            except TimeoutError:
                continue
            self.heard += lines
            times -= sum(line.startswith(word) for line in lines)
        return times <= 0

    def close(self) -> None:
        """Close its socket."""
        self._socket.close()
