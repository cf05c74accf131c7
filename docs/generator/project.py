"""Facts of the project that the site repeats: its addresses, from `pyproject.toml`."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The folder of the project."""


@dataclass(frozen=True)
class Addresses:
    """Addresses of the project on the network."""

    site: str
    """The site, ending with a slash."""
    repository: str
    """The repository, without a slash at its end."""

    def of_file(self, path: str) -> str:
        """Return the address of a file or folder in the repository."""
        return f"{self.repository}/blob/main/{path}"


def addresses(pyproject: str) -> Addresses:
    """Return the addresses that a `pyproject.toml` states under `[project.urls]`."""
    urls = tomllib.loads(pyproject)["project"]["urls"]
    return Addresses(urls["Documentation"].rstrip("/") + "/", urls["Repository"].rstrip("/"))
