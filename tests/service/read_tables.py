"""The tables that a service in the test's process reads, one for each statement."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Engine, event


@contextmanager
def tables_read() -> Iterator[list[str]]:
    """Give the list to which each statement of a block adds its table."""
    tables = list[str]()

    def note(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        tables.extend(re.findall(r"\bFROM (\w+)", statement)[:1])

    event.listen(Engine, "before_cursor_execute", note)
    try:
        yield tables
    finally:
        event.remove(Engine, "before_cursor_execute", note)
