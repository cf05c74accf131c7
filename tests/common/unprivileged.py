"""Doing as a user without privileges does: root may read everything."""

import codecs
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NOBODY = 65_534


@contextmanager
def without_root(folder: Path) -> Iterator[None]:
    """Drop the privileges of root, if there are any, for the block; `folder` is then that user's."""
    if os.geteuid() != 0:
        yield
        return
    codecs.lookup("utf-8-sig")  # loaded at its first use, which that user may not do where Python is in root's home
    os.chown(folder, NOBODY, NOBODY)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)
