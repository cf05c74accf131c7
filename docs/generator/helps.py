"""The output of commands: the help of each, and the map of the Modbus registers."""

import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout, suppress

from beamtouch_daemon import cli as daemon
from beamtouch_models import cli as design
from beamtouch_models.lab.rig import cli as rig
from beamtouch_service import cli as service

Main = Callable[[Sequence[str]], int]
PROGRAMS: dict[str, Main] = {
    "design-sensors": design.main,
    "beamtouch-rig": rig.main,
    "beamtouch-daemon": daemon.main,
    "beamtouch-service": service.main,
}
_COMMAND = re.compile(r"^    ([a-z][a-z-]+)(?: |$)", re.MULTILINE)
_VALUE_TWICE = re.compile(r"^  (-\w) (\S+), (--\S+) \2(?=\s)", re.MULTILINE)


def all_helps() -> Iterator[tuple[str, str]]:
    """Yield every command, such as `design-sensors build`, with what its `--help` prints."""
    for program, main in PROGRAMS.items():
        text = help_of(main)
        yield program, text
        for command in commands_in(text):
            yield f"{program} {command}", help_of(main, command)


def help_of(main: Main, *command: str) -> str:
    """Return what `--help` of a command prints; in words as Python 3.13 and later: an option has its value once."""
    text = _printed(main, *command, "--help")
    once = _VALUE_TWICE.sub(lambda found: f"  {found[1]}, {found[3]} {found[2]}".ljust(len(found[0])), text)
    return re.sub(" +$", "", once, flags=re.MULTILINE)


def registers() -> str:
    """Return the map of the Modbus registers, as Markdown."""
    return _printed(service.main, "registers").strip()


def _printed(main: Main, *arguments: str) -> str:
    printed = io.StringIO()
    with redirect_stdout(printed), suppress(SystemExit):  # argparse ends the program after a help
        main(arguments)
    return printed.getvalue()


def commands_in(text: str) -> list[str]:
    """Return the commands that a help lists, in their order."""
    listed = text.partition("positional arguments:")[2].partition("\noptions:")[0]
    return _COMMAND.findall(listed)


def helps_as_markdown() -> str:
    """Return every help under a heading of its own."""
    parts = []
    for name, text in all_helps():
        level = "##" if name in PROGRAMS else "###"
        parts.append(f"{level} {name}\n\n```text\n{text.strip()}\n```")
    return "\n\n".join(parts)
