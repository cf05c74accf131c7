"""Contacts on a line whose zeros drift, with what `build` writes: none is lost, and none wrong without a note."""

import tomllib

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_models.design.building.daemon_config import daemon_config
from beamtouch_models.filters import TARED, Rested
from beamtouch_models.runtime import ModelFile, State
from system.drifting_line import Course, Line, Press, drift, knock, presses

HOURS_AGO = Rested(4 * 3600)
"""A tare."""
ALL, SECOND = (1.0, 1.0, 1.0, 1.0), (0.0, 1.0, 0.0, 0.0)


def line(model: ModelFile, rested: Rested = TARED) -> Line:
    (table,) = tomllib.loads(daemon_config(model.metadata))["surfaces"].values()
    return Line(model, Surface.model_validate(table), rested=rested)


@pytest.mark.parametrize("seconds", [90, pytest.param(180, marks=pytest.mark.soak)])
@pytest.mark.parametrize(
    ("channels", "every_s"),
    [
        pytest.param(ALL, 2.0, id="all together", marks=pytest.mark.soak),
        pytest.param(SECOND, 2.0, id="one by itself"),
        pytest.param(ALL, 20.0, id="seldom touched"),
    ],
)
def test_a_drift_of_5_um_a_minute_costs_no_contact(
    channels: tuple[float, ...], every_s: float, seconds: int, bench: ModelFile
) -> None:
    said = line(bench).play(Course(seconds, presses(bench, seconds, every_s), drift(5.0, channels)))
    assert (said.lost, len(said.wrong), said.false) == (0, 0, 0)
    assert said.share(State.CLEAR) > 0.995
    assert np.mean(said.held) > 0.93
    assert said.gains == set()


@pytest.mark.soak
def test_a_contact_of_minutes_widens_instead_of_wandering_and_the_rest_after_it_is_clear(bench: ModelFile) -> None:
    long = Press(5.0, 305.0, 150.0, 8.0)
    said = line(bench).play(Course(320, [long], drift(5.0, SECOND)))
    assert (said.lost, said.wrong, said.notes["unsteady"] < 200) == (0, set(), True)
    assert np.mean(said.held) > 0.93
    assert said.interval_mm[-1] > 4 * np.median(said.interval_mm[:100])
    assert said.share(State.CLEAR) == 1.0


def test_a_knock_is_noticed_at_once_and_is_not_healed_within_a_minute(bench: ModelFile) -> None:
    said = line(bench).play(Course(60, [], knock(60.0, 10.0, SECOND)))
    assert 10.0 < said.unexplained_at_s[0] < 11.0
    assert said.unexplained_at_s[-1] > 59.0


def test_a_start_hours_after_the_tare_is_clear_at_rest_and_wide_under_a_load(bench: ModelFile) -> None:
    warm = knock(30.0, -1.0, ALL)
    said = line(bench, HOURS_AGO).play(Course(40, presses(bench, 40, 2.0), warm))
    assert (said.lost, said.wrong, said.false, said.share(State.CLEAR)) == (0, set(), 0, 1.0)
    loaded = line(bench, HOURS_AGO).play(Course(40, [Press(-1.0, 20.0, 150.0, 8.0)], warm))
    assert (loaded.lost, loaded.wrong, loaded.share(State.CLEAR)) == (0, set(), 1.0)
    assert np.mean(loaded.held) > 0.93
    assert np.median(loaded.interval_mm) > 2 * np.median(said.interval_mm)


@pytest.mark.soak
def test_a_load_that_goes_in_half_a_minute_leaves_a_rest_that_is_clear(bench: ModelFile) -> None:
    said = line(bench).play(Course(140, [Press(5.0, 125.0, 200.0, 2.0, 30.0)], drift(0.0, ALL)))
    assert said.share(State.CLEAR) > 0.95
