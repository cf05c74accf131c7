"""The times of inferences in a trade, on a clock whose time is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from beamtouch_models.design.effort import Effort
from beamtouch_models.lab.trade import measure
from beamtouch_models.lab.trade.measure import CALLS, ROUNDS, MeasuredModel, inference_times
from models.test_trade_results import a_model
from support.surfaces.small_model import content_of

CALLED_NS = (2_000, 3_500, 8_000)
"""What each call takes; in each of a round's fifty the next one of these, and one ns more for each call before."""


def timed(channels: int, effort: float) -> MeasuredModel:
    model = a_model(sensors=channels)
    return replace(model, graph=content_of(channels=channels), task=replace(model.task, effort=Effort(effort)))


def test_a_time_is_the_median_of_all_calls_in_microseconds_with_the_error_of_the_rounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_ns, read = 0, 0

    def clock() -> int:
        nonlocal now_ns, read
        if read % 2:  # the end of a call
            call = read // 2
            now_ns += CALLED_NS[call % 3] + call
        read += 1
        return now_ns

    monkeypatch.setattr(measure, "time", SimpleNamespace(perf_counter_ns=clock))
    models = [timed(3, 0.1), timed(4, 0.1)]
    times = inference_times(models)
    assert (ROUNDS, CALLS) == (40, 50)
    rounds = 4
    assert read == 2 * 2 * rounds * CALLS
    taken = np.array([CALLED_NS[call % 3] + call for call in range(2 * rounds * CALLS)]) / 1e3
    # The models take turns, so that a slow moment of the machine falls on all of them.
    for place, found in enumerate(times):
        own = taken.reshape(rounds, 2, CALLS)[:, place]
        assert found.value == pytest.approx(np.median(own))
        of_rounds = np.median(own, axis=1)
        assert found.standard_error == pytest.approx(((of_rounds - of_rounds.mean()) ** 2).sum() ** 0.5 / 12**0.5)
    assert times[0].value != times[1].value
