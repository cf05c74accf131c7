"""Builds and other commands in a part of the time, for tests that do not ask for figures; all their steps remain."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def few_draws() -> Iterator[None]:
    """Measure the accuracy on a few simulated samples."""
    # Here, as most folders of tests build no model, and each of their processes would take a second to import this.
    from beamtouch_models.building import measure, since_touch  # noqa: PLC0415

    with pytest.MonkeyPatch.context() as fewer:
        fewer.setattr(measure, "ACCURACY_DRAWS", 512)
        fewer.setattr(since_touch, "KNOWN", 512)
        yield


@contextmanager
def short_work() -> Iterator[None]:
    """Also score few layouts, draw few contacts for every figure, train little, and time few inferences."""
    from beamtouch_models.building import sensors, since_touch  # noqa: PLC0415  # as above
    from beamtouch_models.building.report import page  # noqa: PLC0415
    from beamtouch_models.commands import explain, place  # noqa: PLC0415
    from beamtouch_models.estimators import estimator, paper_network  # noqa: PLC0415
    from beamtouch_models.placement import placing, position_error, search  # noqa: PLC0415
    from beamtouch_models.trade import measure  # noqa: PLC0415

    with few_draws(), pytest.MonkeyPatch.context() as less:
        for module, name, value in (
            (search, "MAX_EVALUATIONS", 40),
            (placing, "FINAL_DRAWS", 256),
            (position_error, "CELLS", (64, 128)),
            (position_error, "KNOWN_FORCE_CONTACTS", 64),
            (position_error, "OPEN_FORCE_CONTACTS", 64),
            (sensors, "FAILED_DRAWS", 64),
            (explain, "REPEATS", 1),
            (place, "LIMIT_DRAWS", 256),
            (since_touch, "CONTACTS", 8),
            (since_touch, "MOST", 64),
            (estimator, "DRAWS", 64),
            (paper_network, "PATIENCE", 10),
            (page, "PROFILE_DRAWS", 500),
            (page, "LAYOUT_DRAWS", 200),
            (measure, "CALLS", 5),
            (measure, "ROUNDS", 2),
        ):
            less.setattr(module, name, value)
        yield
