"""Names that users give: of surfaces, channels, zones, beams and models.

A name becomes a part of paths, addresses, topics and file names. So it holds nothing that separates parts there, and
does not begin with a dot: `..` would be the folder above, and a file with such a name hidden.
"""

import re
from typing import Annotated

from pydantic import Field

NAME = r"^[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}$"
RULE = 'have 1 to 64 letters, digits, "_", "-" or ".", and not begin with "."'
"""The rule of `NAME`, in words."""
_LONGEST = 64

Name = Annotated[str, Field(pattern=NAME)]


def name_like(text: str, instead: str) -> str:
    """Return a name that resembles a text; `instead` if nothing is left of it."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", text).lstrip(".")[:_LONGEST] or instead
