"""Choice of the samples of an unexplained stretch that are examined channel by channel. Pure."""

WHOLE = 200
"""Number of samples at the beginning of a stretch, all of which are kept."""
_PER_DOUBLING = 25
"""Number of samples that are kept each time that the stretch becomes twice as long."""
_EVERY = 20
"""One in this many samples is examined without each channel: 40 of them in 4 s at 200 samples a second."""


def is_kept(number: int) -> bool:
    """Return whether to keep a sample of a stretch in its capture; the first has number 0."""
    if number < WHOLE:
        return True
    doublings = (number // WHOLE).bit_length() - 1
    return number % ((WHOLE // _PER_DOUBLING) << doublings) == 0


def is_asked(number: int) -> bool:
    """Return whether to examine a sample without each channel, which takes long."""
    return is_kept(number) or number % _EVERY == 0
