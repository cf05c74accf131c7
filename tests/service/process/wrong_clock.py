"""A wall clock that is wrong in one process, and can be set while it runs: libfaketime. Its other clocks are right."""

import os
from pathlib import Path

from support.running.debian_parts import give_up

_FOLDERS = ("/usr/lib/*/faketime", "/usr/lib/faketime")


class WrongClock:
    """The wall clock of processes that get its `environment`."""

    def __init__(self, folder: Path, offset: str) -> None:
        """Begin with an offset from the clock of the machine, as in "+3650d"; "+0" is right."""
        libraries = [one for place in _FOLDERS for one in Path("/").glob(f"{place[1:]}/libfaketimeMT.so.1")]
        if not libraries:
            give_up("libfaketime is not installed: apt-get install faketime")
        self._file = folder / "clock"
        self.set(offset)
        self.environment = dict(os.environ) | {
            "LD_PRELOAD": str(libraries[0]),
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_NO_CACHE": "1",
            # Both names, as it was renamed: ages and waits keep to the true clocks, as on a machine whose clock is set.
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "DONT_FAKE_MONOTONIC": "1",
            # Otherwise it takes waits by the true clock for waits by the wrong one, and threads ask all the time.
            "FAKETIME_FORCE_MONOTONIC_FIX": "0",
        }

    def set(self, offset: str) -> None:
        """Set the clock, as NTP or a person does."""
        new = self._file.with_suffix(".new")
        new.write_text(f"{offset}\n")
        new.replace(self._file)
