"""Errors of the record: when it takes and gives nothing, and why."""

from sqlalchemy.exc import DBAPIError


class RecordAwayError(Exception):
    """The record takes nothing now; the message gives its reason, in one line. What failed can be tried again."""


class UnreadableRowError(RecordAwayError):
    """A row is damaged; the message gives the reason, in one line. Others may be whole."""


class RecordUnusableError(RecordAwayError):
    """The record cannot be used as it is; the message gives the reason and the remedy, in one line."""


def reason_of(error: Exception) -> str:
    """Return the first line of the message of an error, that of the database if it has one."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    return (str(cause).strip().splitlines() or [type(cause).__name__])[0]
