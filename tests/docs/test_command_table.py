"""The table of commands: every command has a row, and every row is a command."""

import re

from helps import PROGRAMS, all_helps
from pasted import ROOT

TEXT = (ROOT / "docs" / "reference" / "commands.md").read_text()


def test_every_command_has_a_row_in_the_table() -> None:
    rows = re.findall(r"^\| `((?:design-sensors|beamtouch-[a-z]+)(?: [a-z-]+)?)[ `]", TEXT, re.MULTILINE)
    commands = [command for command, _ in all_helps()]
    with_commands = {command.partition(" ")[0] for command in commands if " " in command}

    assert set(rows) == set(commands) - with_commands
    assert with_commands < set(PROGRAMS)
