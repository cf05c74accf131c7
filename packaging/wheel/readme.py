"""The README in the metadata of the distribution: its links hold wherever it is shown."""

import sys
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "generator"))
from links import absolute  # noqa: E402  # the functions of the site are not installed
from project import addresses  # noqa: E402


class ReadmeHook(MetadataHookInterface):
    """Sets the field `readme`, which `pyproject.toml` declares as dynamic."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add the README, with absolute links."""
        known = addresses((ROOT / "pyproject.toml").read_text())
        text = absolute((ROOT / "README.md").read_text(), known)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
