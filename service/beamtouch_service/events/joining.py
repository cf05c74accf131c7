"""Two segments of one event become one. Pure: no clock, no I/O."""

from dataclasses import replace

from beamtouch_service.events.best_samples import better
from beamtouch_service.events.segments import AFTER_CLEAR, BEFORE_CLEAR, End, EventKind, Segment, sums_of, thin

_ENDS_OF_CONTACT = {End.CLEAR: End.UNEXPLAINED, End.CONTACT: End.UNSEEN}
"""End of an unexplained stretch -> end of the contact that it turns out to belong to."""


def are_apart(left: Segment, right: Segment) -> bool:
    """Return whether a clear sample lies between two segments of consecutive numbers."""
    is_after = right.first_sequence > left.last_sequence
    return is_after and (right.begin in AFTER_CLEAR or left.end in BEFORE_CLEAR)


def are_one(left: Segment, right: Segment) -> bool:
    """Return whether two segments that meet or overlap belong to one event; `left` began earlier.

    An unexplained stretch belongs to the contact before it, and never to the one after it.
    """
    return not are_apart(left, right) and (left.kind is EventKind.CONTACT or right.kind is EventKind.UNEXPLAINED)


def _without_first(segment: Segment, last_known: int) -> Segment:
    """Return a segment whose sums leave out the samples up to number `last_known`, in proportion."""
    known = last_known - segment.first_sequence + 1
    if known <= 0:
        return segment
    part = max(0.0, 1 - known / (segment.last_sequence - segment.first_sequence + 1))
    samples = round(segment.samples * part)
    return replace(
        segment,
        samples=samples,
        position_sum_mm=segment.position_sum_mm * samples / max(1, segment.samples),
        unexplained_us=round(segment.unexplained_us * part),
    )


def joined(left: Segment, right: Segment) -> Segment:
    """Return two segments that meet or overlap as one; `left` is the one that began earlier, and gives the kind."""
    between_us = max(0, right.touched_us - left.last_us) if left.ends_unexplained else 0
    later = left if left.last_sequence > right.last_sequence else right
    added = _without_first(right, left.last_sequence)
    return replace(
        left,
        last_sequence=later.last_sequence,
        last_us=later.last_us,
        lifted_us=later.lifted_us,
        end=later.end if later.kind is left.kind else _ENDS_OF_CONTACT.get(later.end, later.end),
        **sums_of(left).plus(sums_of(added))._asdict(),
        unexplained_us=left.unexplained_us + between_us + added.unexplained_us,
        ends_unexplained=later.ends_unexplained,
        degraded=left.degraded or right.degraded,
        best=better(left.best, right.best),
        path=thin(sorted({point[0]: point for point in [*left.path, *right.path]}.values())),
    )
