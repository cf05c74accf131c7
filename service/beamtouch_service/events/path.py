"""The path of a contact: where it was, and how hard it pressed, at a bounded number of times. Pure.

Time is divided into parts of equal length from the touch on. The first sample of each part is a point of the path, and
so is the last sample of all. The parts double whenever there would be too many points. So a path depends on the samples
alone, and a long one changes little from one commit to the next.
"""

import json
import zlib
from collections.abc import Sequence
from datetime import datetime
from itertools import groupby
from typing import NamedTuple

from beamtouch_service.surfaces.contact import rfc3339

MAX_POINTS = 200


class Point(NamedTuple):
    """A position at a time."""

    at_ms: int
    """[ms since 1970]."""
    position_mm: float
    force_n: float | None


class Path:
    """A path while its samples arrive."""

    def __init__(self, begin_us: int, part_ms: int = 1) -> None:
        """Begin a path of an event that began then [us since 1970], with parts of this length."""
        self.part_ms = part_ms
        self._begin_ms = begin_us // 1000
        self._firsts: list[Point] = []
        """The first point of each part."""
        self._last: Point | None = None

    @classmethod
    def read(cls, begin_us: int, text: str, part_ms: int) -> "Path":
        """Go on with a path as it was written."""
        path = cls(begin_us, part_ms)
        for point in json.loads(text):
            at_ms = round(datetime.fromisoformat(point["at"]).timestamp() * 1e3)
            path._add(Point(at_ms, point["position_mm"], point["force_n"]))
        return path

    @property
    def points(self) -> list[Point]:
        """The points so far, in the order of their samples."""
        last = self._last
        return self._firsts.copy() if last is None or last == self._firsts[-1] else [*self._firsts, last]

    def add(self, at_us: int, position_mm: float, force_n: float | None) -> None:
        """Add the next sample."""
        self._add(Point(at_us // 1000, position_mm, force_n))

    def _add(self, point: Point) -> None:
        self._last = point
        if not self._firsts or self._part(point) != self._part(self._firsts[-1]):
            self._firsts.append(point)
        while len(self._firsts) >= MAX_POINTS:
            self.part_ms *= 2
            self._firsts = [next(same) for _, same in groupby(self._firsts, self._part)]

    def _part(self, point: Point) -> int:
        # A clock may be set back.
        return abs(point.at_ms - self._begin_ms) // self.part_ms


def pack(points: Sequence[Point]) -> bytes:
    """Return a path as the record holds it: the JSON of the answer, compressed to a seventh."""
    return zlib.compress(f"[{','.join(map(_encode, points))}]".encode())


def _encode(point: Point) -> str:
    force_n = "null" if point.force_n is None else point.force_n
    return f'{{"at":"{rfc3339(point.at_ms * 1000)}","position_mm":{point.position_mm},"force_n":{force_n}}}'


def unpack(packed: bytes) -> str:
    """Return the JSON of a path; raises ValueError if it is damaged."""
    try:
        return zlib.decompress(packed).decode()
    except zlib.error as error:
        raise ValueError(f"path: {error}") from None
