"""Builds in a quarter of the time, for tests that do not ask for the thresholds and the accuracy of a model."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def few_draws() -> Iterator[None]:
    """Measure thresholds and accuracy on a few simulated samples; all steps of a build remain."""
    # Here, as most folders of tests build no model, and each of their processes would take a second to import this.
    from beamtouch_models.accuracy import unexplained_thresholds  # noqa: PLC0415
    from beamtouch_models.building import measure, since_touch  # noqa: PLC0415

    with pytest.MonkeyPatch.context() as fewer:
        fewer.setattr(measure, "ACCURACY_DRAWS", 512)
        fewer.setattr(since_touch, "KNOWN", 512)
        fewer.setattr(unexplained_thresholds, "DRAWS", 512)
        yield
