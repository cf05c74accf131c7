"""Mistakes of users with their answers, from mistakes.toml; run as a program, it writes docs/mistakes.md."""

import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from support.surfaces import configs
from support.surfaces.example_scenes import SCENES

DOCUMENT = Path(__file__).parents[2] / "docs" / "mistakes.md"
COMMANDS = {
    "scene": "design-sensors explain scene.toml",
    "daemon": "beamtouch-daemon check daemon.toml",
    "service": "beamtouch-service run --config service.toml",
}
SERVICE = """
[server]
port = 8420

[events]
file = "events.db"
keep_days = 30

[surfaces.press-7]
stale_ms = 500
"""
TITLES = {
    "scene": "In a scene",
    "daemon": "In a configuration of the daemon",
    "service": "In a configuration of the service",
    "command": "In a command",
}


@dataclass(frozen=True)
class Mistake:
    """A mistake: in a file, or in a command beside a good scene."""

    kind: str
    typed: str
    """What stands in the file, or the command."""
    in_place_of: str
    answer: str
    """The whole line on standard error."""

    @property
    def command(self) -> list[str]:
        """The command that meets it."""
        return COMMANDS.get(self.kind, self.typed).split()

    def write(self, folder: Path) -> None:
        """Write the files, of which one has the mistake."""
        configs.write(folder, configs.surface())
        (folder / "scene.toml").write_text((SCENES / "bench.toml").read_text())
        (folder / "service.toml").write_text(SERVICE)
        if self.kind != "command":
            path = folder / f"{self.kind}.toml"
            text = path.read_text()
            assert self.in_place_of in text
            path.write_text(text.replace(self.in_place_of, self.typed, 1))

    @property
    def shown(self) -> str:
        """The mistake in Markdown."""
        lines = [line for line in (self.typed or self.in_place_of).splitlines() if line]
        code = "<br>".join(f"`{line}`" for line in lines)
        return code if self.typed else f"no {code}"


def mistakes() -> list[Mistake]:
    """Return all mistakes."""
    content = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
    return [
        Mistake(one.get("file", "command"), one.get("states", one.get("command")), one.get("in_place_of", ""), answer)
        for one in content["mistake"]
        for answer in [one["answer"]]
    ]


def document() -> str:
    """Return docs/mistakes.md."""
    parts = [
        "# Mistakes and their answers\n\n"
        "Each command answers a mistake in one line on standard error and ends with exit code 2. Apart from the\n"
        "mistake that is shown, the files are correct. A test makes every mistake.\n"
    ]
    for kind, title in TITLES.items():
        rows = [f"| {one.shown} | {one.answer.replace('|', chr(92) + '|')} |" for one in mistakes() if one.kind == kind]
        typed = f"\nThe command is `{COMMANDS[kind]}`.\n" if kind in COMMANDS else ""
        parts.append(f"## {title}\n{typed}\n| mistake | answer |\n|---|---|\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    DOCUMENT.write_text(document())
