"""Names of hosts that only one process knows: a file of its own in the place of /etc/hosts."""

import os
from dataclasses import dataclass
from pathlib import Path

SCRIPT = 'mount --bind "$0" /etc/hosts && exec "$@"'


@dataclass(frozen=True)
class HostNames:
    """A file of names; programs that are started with `prefix` before their command use it."""

    path: Path

    @property
    def prefix(self) -> tuple[str, ...]:
        """Return the command that comes first."""
        as_root = () if os.geteuid() == 0 else ("--map-root-user",)
        return ("unshare", *as_root, "--mount", "sh", "-c", SCRIPT, str(self.path))

    def add(self, name: str, address: str) -> None:
        """Make a name known to the running processes, too."""
        with self.path.open("a") as file:
            file.write(f"{address} {name}\n")

    def move(self, name: str, address: str) -> None:
        """Have a name stand for another address."""
        others = [line for line in self.path.read_text().splitlines() if not line.endswith(f" {name}")]
        self.path.write_text("\n".join([*others, f"{address} {name}"]) + "\n")


def host_names_in(folder: Path) -> HostNames:
    """Return a file that knows localhost."""
    path = folder / "hosts"
    path.write_text("127.0.0.1 localhost\n")
    return HostNames(path)
