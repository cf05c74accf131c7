"""The samples of an unexplained stretch that are looked into channel by channel. Pure."""

WHOLE = 200
"""Samples at the beginning of a stretch that are all kept."""
_PER_DOUBLING = 25
"""Samples that are kept each time that the stretch becomes twice as long."""
_EVERY = 20
"""Every so many samples are asked which channel contradicts the others: 40 of them in 4 s at 200 samples a second."""


def is_kept(number: int) -> bool:
    """Return whether to keep a sample of a stretch in its capture; the first has number 0."""
    if number < WHOLE:
        return True
    doublings = (number // WHOLE).bit_length() - 1
    return number % ((WHOLE // _PER_DOUBLING) << doublings) == 0


def is_asked(number: int) -> bool:
    """Return whether to leave out each channel of a sample in turn, which is dear."""
    return is_kept(number) or number % _EVERY == 0
