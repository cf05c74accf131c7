"""Contacts from touch to lift, put together from pieces. Pure: no clock, no I/O.

A piece is a run of samples in a row, all of one contact. Pieces of a contact come in any order, since samples do; two
that meet become one. What was not seen is not made up: a contact next to a gap has an unseen touch or lift.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum

from beamtouch_service.surfaces.contact import Figures

MOST_POINTS = 200
"""Points of a path; more are thinned to evenly spread times."""

Point = tuple[int, float, float | None]
"""Time [us since 1970], position [mm], force [N]."""


class Begin(StrEnum):
    """How a contact began."""

    TOUCH = "touch"
    """The sample before the first was clear."""
    UNSEEN = "unseen"
    """The sample before the first is not known."""


class End(StrEnum):
    """How a contact ended."""

    LIFT = "lift"
    """The sample after the last was clear."""
    UNSEEN = "unseen"
    """The sample after the last is not known."""
    OPEN = "open"
    """It goes on."""
    STALE = "stale"
    """No sample followed for longer than the surface's limit."""
    UNFINISHED = "unfinished"
    """The service stopped during it."""


@dataclass(frozen=True)
class Piece:
    """A part of a contact, or all of it."""

    surface: str
    model: str
    boot_id: str
    first_sequence: int
    last_sequence: int
    touched_us: int
    """When its first sample was taken, by the sender's clock [us since 1970]."""
    last_us: int
    lifted_us: int | None = None
    """When the first clear sample after it was taken; None where that was not seen."""
    begin: Begin = Begin.UNSEEN
    end: End = End.OPEN
    samples: int = 0
    """Samples with a position."""
    position_sum_mm: float = 0.0
    peak_force_n: float | None = None
    peak_position_mm: float | None = None
    """Where the force was at its peak."""
    degraded: bool = False
    """Some sample lacked channels, or could not be decided on."""
    path: list[Point] = field(default_factory=list)


class GrowingPiece:
    """A piece that takes sample after sample, a thousand times a second: in place, unlike `Piece`."""

    def __init__(self, first: Piece) -> None:
        """Begin with a piece whose first sample is yet to be added."""
        self._first = first
        self._last = first.first_sequence, first.touched_us
        self._samples = 0
        self._position_sum_mm = 0.0
        self._peak: tuple[float | None, float | None] = None, None
        """Force [N], and where it was [mm]."""
        self._degraded = False
        self._path: list[Point] = []

    @property
    def duration_us(self) -> int:
        """From its first sample to its last, by the sender's clock."""
        return abs(self._last[1] - self._first.touched_us)

    def add(self, sequence: int, acquired_us: int, figures: Figures | None, *, degraded: bool) -> None:
        """Take the next sample; `figures` is None for one that could not be decided on."""
        self._last = sequence, acquired_us
        self._degraded |= degraded
        if figures is None or figures.position_mm is None:
            return
        position_mm, force_n = figures.position_mm, figures.force_n
        self._samples += 1
        self._position_sum_mm += position_mm
        if force_n is not None and (self._peak[0] is None or force_n > self._peak[0]):
            self._peak = force_n, position_mm
        self._path.append((acquired_us, position_mm, force_n))
        if len(self._path) > 2 * MOST_POINTS:
            self._path = thin(self._path)

    def piece(self) -> Piece:
        """Return what it has come to."""
        return replace(
            self._first,
            last_sequence=self._last[0],
            last_us=self._last[1],
            samples=self._samples,
            position_sum_mm=self._position_sum_mm,
            peak_force_n=self._peak[0],
            peak_position_mm=self._peak[1],
            degraded=self._degraded,
            path=list(self._path),
        )


def _summed(one: Piece, other: Piece) -> Piece:
    forces = [(piece.peak_force_n, piece.peak_position_mm) for piece in (one, other) if piece.peak_force_n is not None]
    force, position = max(forces, key=lambda entry: entry[0] or 0.0, default=(None, None))
    return replace(
        one,
        samples=one.samples + other.samples,
        position_sum_mm=one.position_sum_mm + other.position_sum_mm,
        peak_force_n=force,
        peak_position_mm=position,
        degraded=one.degraded or other.degraded,
    )


def _beyond(piece: Piece, sequence: int) -> Piece:
    """Return a piece with its sums reduced to the part after a sample, which they hold only in the mean."""
    known = sequence - piece.first_sequence + 1
    if known <= 0 or not piece.samples:
        return piece
    samples = round(piece.samples * max(0.0, 1 - known / (piece.last_sequence - piece.first_sequence + 1)))
    return replace(piece, samples=samples, position_sum_mm=piece.position_sum_mm / piece.samples * samples)


def joined(left: Piece, right: Piece) -> Piece:
    """Return one piece of two that meet or overlap, `left` being the one that began earlier."""
    later = left if left.last_sequence > right.last_sequence else right
    return replace(
        _summed(left, _beyond(right, left.last_sequence)),
        last_sequence=later.last_sequence,
        last_us=later.last_us,
        lifted_us=later.lifted_us,
        end=later.end,
        path=thin(sorted({point[0]: point for point in [*left.path, *right.path]}.values())),
    )


def thin(path: list[Point]) -> list[Point]:
    """Return a path of at most `MOST_POINTS` points, spread evenly over its time; its ends stay."""
    if len(path) <= MOST_POINTS:
        return path
    begin = path[0][0]
    width_us = max(1.0, (path[-1][0] - begin) / (MOST_POINTS - 2))
    bins = {int((point[0] - begin) / width_us): point for point in reversed(path)}
    kept = sorted([*bins.values(), path[-1]])
    return [point for index, point in enumerate(kept) if index == 0 or point != kept[index - 1]][:MOST_POINTS]
