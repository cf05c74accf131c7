"""Which tests run in one process: those of modules that make something once, so that it is made once per run."""

import re
from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling

MADE_ONCE = re.compile(r'scope="module"|^@cache|= cache\(', re.MULTILINE)
# Pages share a browser; started for each test, it would take longer than most of them. Its event loop runs on beside
# the other tests of its process, which must not start one of their own.
BROWSER, OWN_LOOP = re.compile(r"\bopen_page\b|\bbrowser: Browser\b"), "asyncio"
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
    text = module.read_text()
    return MADE_ONCE.search(text) is not None or (BROWSER.search(text) is not None and OWN_LOOP not in text)
