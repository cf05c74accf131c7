"""A fault in one function of a program under test, which a file begins and ends."""

from pathlib import Path

_CODE = """
import os
from beamtouch_common import parts, waits
parts.FIRST_PAUSE_S = parts.LONGEST_PAUSE_S = 0.1
waits.STEADY_S = 0.5

import {module}
holder = {module}
for name in {owner!r}.split(".") if {owner!r} else ():
    holder = getattr(holder, name)
own = holder.{function}

def broken(*arguments, **options):
    if os.path.exists({fault!r}):
        1 / 0
    return own(*arguments, **options)

holder.{function} = broken
"""
WORDS = "unexpected error (ZeroDivisionError('division by zero')); restarting"
"""How a part that fails for it is named."""


def broken(module: str, owner: str, function: str, fault: Path) -> str:
    """Return code by which a function fails while there is a file, and parts that fail are soon begun again."""
    return _CODE.format(module=module, owner=owner, function=function, fault=str(fault))
