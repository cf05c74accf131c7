"""The file of a record, changed behind the back of its service."""

import sqlite3
from contextlib import closing
from pathlib import Path


def execute(path: Path, statement: str, *values: float | str) -> None:
    """Execute an SQL statement with its values, and commit."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(statement, values)
        connection.commit()
