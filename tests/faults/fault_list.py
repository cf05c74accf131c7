"""The list of faults that tests must catch, `tests/faults/faults.toml`."""

import tomllib
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

ROOT = Path(__file__).parents[2]
LIST = Path(__file__).with_name("faults.toml")


class Fault(BaseModel):
    """A change of a file that breaks a promise."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    promise: str = Field(min_length=1)
    """What users are promised, and no longer get."""
    file: str
    """From the top folder."""
    before: str = Field(min_length=1)
    """Lines of the file, which stand in it once."""
    after: str
    """What stands there with the fault."""
    tests: tuple[str, ...] = Field(min_length=1)
    """Arguments of pytest: files, or single tests."""


def read_faults(path: Path = LIST) -> list[Fault]:
    """Return the faults of a list; ValueError if one does not fit the tree."""
    faults = [Fault.model_validate(entry) for entry in tomllib.loads(path.read_text())["fault"]]
    for fault in faults:
        if (count := (ROOT / fault.file).read_text().count(fault.before)) != 1:
            raise ValueError(f"{fault.promise!r}: {fault.file} has the lines before the fault {count} times")
    return faults
