"""Which tests run in one process: those of modules that make something once, so that it is made once per run."""

import re
from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling

# Pages share a browser; started for each test, it would take longer than most of them. One for all modules would keep
# its event loop running beside other tests.
MADE_ONCE = re.compile(r'scope="module"|\bopen_page\b|\bbrowser: Browser\b|^@cache|= cache\(', re.MULTILINE)
TOGETHER = ("models/test_false_alarms.py",)
"""Modules that make something once in what they import."""


class Scheduling(LoadScopeScheduling):  # type: ignore[misc]  # xdist ships no types
    """Gives each test to whichever process is free, but modules that make something once whole.

    The mark `xdist_group` would say the same, but with pytest 9.2 the scheduler never sees it: the tests of a group
    would be spread over all processes, without an error.
    """

    def _split_scope(self, nodeid: str) -> str:
        module = nodeid.partition("::")[0]
        is_whole = module.endswith(TOGETHER) or makes_once(self.config.rootpath / module)
        return module if is_whole else nodeid


@cache
def makes_once(module: Path) -> bool:
    """Return whether a module has a fixture, a cache or a browser for all of its tests."""
    return MADE_ONCE.search(module.read_text()) is not None
