"""An answer as CSV (RFC 4180), in parts."""

import csv
import io
from collections.abc import Iterable

MEDIA_TYPE = "text/csv"
RESPONSES = {"content": {MEDIA_TYPE: {"schema": {"type": "string"}}}}
"""Such an answer in OpenAPI."""
NEXT_LINK = {
    "description": 'Of CSV: the address of the next page from this one, as `<?...>; rel="next"`; none on the last.',
    "schema": {"type": "string"},
}
"""The header with the next page, in OpenAPI."""


class CsvParts:
    """Rows that are taken some at a time, as the bytes of a part."""

    def __init__(self, header: Iterable[str]) -> None:
        self._text = io.StringIO()
        self._writer = csv.writer(self._text, lineterminator="\r\n")
        self.add(header)

    def add(self, row: Iterable[object]) -> None:
        """Add a row. A cell of None is empty."""
        self._writer.writerow(row)

    def take(self) -> bytes:
        """Return the rows since the last part."""
        part = self._text.getvalue().encode()
        self._text.seek(0)
        self._text.truncate()
        return part
