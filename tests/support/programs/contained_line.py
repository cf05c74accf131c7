"""A line whose daemon and service run in containers with read-only roots."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from line import Line, Surface

USER = 10001
IN_ITS_OWN_TREE = 'umount -R -l /sys/fs/cgroup; mount -t cgroup2 cgroup2 /sys/fs/cgroup; exec "$@"'
"""A machine of tests may have the older control groups, which its runtime does not take."""
CONTAINED = [
    *("run", "--rm", "--network", "host", "--cgroups", "disabled", "--read-only", "--cap-drop", "all"),
    *("--security-opt", "no-new-privileges", "--ulimit", "nofile=1024:1024", "--ulimit", "nproc=1024:1024"),
]


def podman_in(store: str, podman: str, crun: str) -> list[str]:
    """Return the beginning of a command of podman whose images are in a folder with a short path."""
    inner = [podman, "--runtime", crun, "--root", f"{store}/root", "--runroot", f"{store}/run"]
    return ["unshare", "--mount", "bash", "-c", IN_ITS_OWN_TREE, "bash", *inner]


class Contained(Line):
    """A line whose daemon and service run in containers, which see its folder."""

    podman: list[str]
    """The beginning of a command of podman."""
    images: dict[str, str]
    """Program -> its image."""
    emulator = ""
    """Of another processor, for all that the containers run."""
    options: Mapping[str, Sequence[str]] = {}
    """Program -> further options of its container."""

    def _start_rig(self, surface: Surface) -> dict[str, Any]:
        """Start the rig of a surface; its serial line is a device of the container of the daemon."""
        source = super()._start_rig(surface)
        if surface.kind != "modbus-tcp":
            line = Path(source["port"]).resolve()
            line.chmod(0o666)
            source["port"] = f"/dev/{surface.name}"
            daemon = "beamtouch-daemon"
            # `--device` would make a node, and that of a pseudo-terminal is none elsewhere.
            passed = ["--volume", f"{line}:{source['port']}"]
            self.options = {**self.options, daemon: [*self.options.get(daemon, ()), *passed]}
        return source

    def _find_program(self, command: list[str]) -> list[str]:
        program, *words = command
        if program not in self.images:
            return super()._find_program(command)
        options = ["--volume", f"{self.folder}:{self.folder}", "--env", "PYTHONUNBUFFERED=1"]
        options += self.options.get(program, ())
        if self.emulator:
            options += ["--volume", f"{self.emulator}:/emulator:ro", "--entrypoint", "/emulator"]
            # The first line of a program names its interpreter, which only the kernel would read.
            interpreter = f"/opt/beamtouch/{program.removeprefix('beamtouch-')}/bin/python"
            words = [interpreter, "-I", f"/usr/bin/{program}", *words]
        return [*self.podman, *CONTAINED, *options, self.images[program], *words]
