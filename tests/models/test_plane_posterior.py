"""The graph of two axes beside exact posteriors: where it places contacts, what it holds, how sure it says it is."""

from functools import cache

import numpy as np
import pytest

from beamtouch_models import SceneError, make_scene, resolve
from beamtouch_models.design.accuracy.cell_posterior import summarize
from beamtouch_models.design.accuracy.drawing import Draws, draw
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.places import grid_of
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.session import Answers, runner, stated_mm
from models.sprung_plate import SIZE_MM, SPRING_N_PER_MM, sunk_mm
from models.test_two_axes import CORNERS_MM, influence_of

AXES = ("x", "y")
DRAWS, EXACT = 250, 80
OF_AN_ELLIPSE = 5.991
"""95 % quantile of chi-square with two degrees of freedom."""


@cache
def answered(
    noise_mm: float, mounting_mm: float, force_n: tuple[float, float], gain: float = 0.003
) -> tuple[Prior, Draws, Answers]:
    influence = influence_of(sunk_mm)
    errors = Errors(noise_mm, gain=gain, zero_mm=noise_mm / 5, mounting_mm=mounting_mm)
    whole = Prior.of(influence, CORNERS_MM, errors)
    prior = Prior(**{**vars(whole), "force_n": force_n})
    drawn = draw(prior, DRAWS, 5)
    run = runner(to_bytes(posterior_graph(prior, with_force=True)))
    return prior, drawn, run(drawn.deflection_mm, prior.errors.whitening(drawn.deflection_mm))


CASES = {
    "loud": (0.0003, 0.0, (2.0, 20.0)),
    "usual": (0.002, 0.0, (2.0, 20.0)),
    "faint": (0.03, 0.0, (2.0, 20.0)),
    "mounted": (0.004, 1.0, (2.0, 20.0)),
    "known force": (0.002, 0.0, (9.9, 10.1)),
    "exact force": (0.002, 0.0, (10.0, 10.0)),
}


@pytest.mark.parametrize("case", CASES)
def test_a_contact_is_where_the_exact_posterior_has_it(case: str) -> None:
    prior, drawn, answers = answered(*CASES[case])
    off = np.linalg.norm(stated_mm(answers, AXES) - drawn.place_mm, axis=1)[:EXACT].mean()
    # The exact posterior has no forces beyond the range, and its cells are as fine as the posterior is.
    exact_mm = summarize(prior, drawn.deflection_mm[:EXACT]).median_mm
    least = np.linalg.norm(exact_mm - drawn.place_mm[:EXACT], axis=1).mean()
    assert off < 1.02 * least


@pytest.mark.parametrize("case", CASES)
def test_intervals_and_ellipse_hold_what_they_say(case: str) -> None:
    prior, drawn, answers = answered(*CASES[case])
    low, high = (stated_mm(answers, AXES, end) for end in (1, 2))
    held = ((low <= drawn.place_mm) & (drawn.place_mm <= high)).mean(axis=0)
    assert np.all(held > 0.95 - 4 * (0.95 * 0.05 / DRAWS) ** 0.5)
    assert np.all(held < (0.99 if prior.force_range.is_open else 0.999))  # decision 060 says why of a known force
    middle, deviation = (low + high) / 2, (high - low) / 2 / 1.96
    u, v = ((drawn.place_mm - middle) / deviation).T
    turned = answers["place_correlation"].astype(np.float64)
    assert np.abs(turned).max() < 1
    inside = (u**2 - 2 * turned * u * v + v**2) / (1 - turned**2) < OF_AN_ELLIPSE
    assert 0.91 < inside.mean() < 0.99


def test_the_correlation_is_that_of_load_cells() -> None:
    """Of a rigid plate on springs, sink and tilts are means of four readings: errors follow from the place."""
    _, drawn, answers = answered(*CASES["usual"], gain=0.0)
    share, reach = 2 * drawn.place_mm / SIZE_MM - 1, 2 * CORNERS_MM[-1] / SIZE_MM - 1
    both = share.prod(axis=1)
    expected = both / np.sqrt((1 / reach[0] ** 2 + share[:, 0] ** 2) * (1 / reach[1] ** 2 + share[:, 1] ** 2))
    loud = (drawn.force_n > 8) & (np.abs(share).max(axis=1) < 0.8)
    assert answers["place_correlation"][loud] == pytest.approx(expected[loud], abs=0.03)


def test_misfit_odds_and_force_are_those_of_closed_forms() -> None:
    prior, drawn, answers = answered(*CASES["usual"])
    # Four readings of a rigid plate, which has three motions: one direction is left, of chi-square 1.
    across = np.array([1.0, -1.0, -1.0, 1.0]) / 2
    variance = prior.errors.variance_mm2(drawn.deflection_mm)
    expected = (drawn.deflection_mm @ across) ** 2 / (variance @ across**2)
    inside = np.abs(2 * drawn.place_mm / SIZE_MM - 1).max(axis=1) < 0.8
    assert answers["misfit"][inside] == pytest.approx(expected[inside], abs=0.05, rel=0.05)
    weighed_n = 4 * SPRING_N_PER_MM * drawn.deflection_mm.mean(axis=1)
    assert answers["force_n"][inside] == pytest.approx(weighed_n[inside], rel=0.01)
    held = (answers["force_low_n"] <= drawn.force_n) & (drawn.force_n <= answers["force_high_n"])
    assert 0.91 < held.mean() < 0.99
    # The log odds: of a plain mean over many places (`thresholds.log_odds`, eq. of the docstring of `answers`).
    places = grid_of([np.linspace(*ends, 121) for ends in prior.extent.ranges_mm])
    for row in np.flatnonzero(drawn.force_n < 4)[:10]:
        white = prior.errors.whitening(drawn.deflection_mm[[row]])[0]
        shape, sample = sunk_mm(CORNERS_MM, places) @ white.T, white @ drawn.deflection_mm[row]
        along = np.maximum(shape @ sample, 0) ** 2 / (shape**2).sum(axis=1) / 2
        odds = along.max() + np.log(np.exp(along - along.max()).mean())
        assert answers["contact_log_odds"][row] == pytest.approx(odds, rel=0.01)


def test_a_contact_at_the_rim_is_held_up_to_the_rim() -> None:
    prior, _, _ = answered(*CASES["usual"])
    rng, run = np.random.default_rng(6), runner(to_bytes(posterior_graph(prior, with_force=False)))
    place = np.column_stack([np.full(300, 390.0), rng.uniform(10, 290, 300)])
    place[:150] = place[:150, ::-1] * [290 / 290, 0] + [100, 10]
    samples = prior.draw(place, rng.uniform(2, 20, 300), rng)
    answers = run(samples, prior.errors.whitening(samples))
    low, high = (stated_mm(answers, AXES, end) for end in (1, 2))
    held = (low - 0.01 <= place) & (place <= high + 0.01)
    assert held.mean(axis=0).min() > 0.92


def test_a_channel_that_is_missing_takes_no_part() -> None:
    prior, drawn, _ = answered(*CASES["usual"])
    run, kept = runner(to_bytes(posterior_graph(prior, with_force=True))), [0, 1, 3]
    valid = np.ones(drawn.deflection_mm.shape, np.bool_)
    valid[:, 2] = False
    seen = np.where(valid, drawn.deflection_mm, 0.0)
    noise = np.eye(4) * prior.errors.noise_mm**2
    answers = run(seen, prior.errors.whitening(seen, noise, valid))
    less = prior.without(2)
    alone = runner(to_bytes(posterior_graph(less, with_force=True)))
    others = alone(seen[:, kept], less.errors.whitening(seen[:, kept]))
    for name in ("x_mm", "y_high_mm", "place_correlation"):
        off = np.abs(answers[name] - others[name])
        assert np.quantile(off, 0.98) < 0.02 * np.ptp(others[name])


def test_a_plate_is_built_into_a_model_that_answers_by_axis() -> None:
    scene = make_scene(
        plate={
            "length_x_mm": 400, "length_y_mm": 300, "thickness_mm": 3, "youngs_modulus_gpa": 210,
            "support_stiffness_n_per_mm": 15,
        },
        contact={"force_n": [2, 20], "x_mm": [10, 390], "y_mm": [10, 290]},
        sensors={"noise_mm": 0.004, "rate_hz": 200},
        requirements={"latency_ms": 20, "descriptors": ["position", "force"]},
    )  # fmt: skip
    layout = resolve(scene).layout(CORNERS_MM)
    model = layout.build("plate", effort=0.01)
    metadata, place_mm = model.metadata, np.array([[100.0, 100.0], [200.0, 50.0], [320.0, 250.0]])
    assert (metadata.axes, metadata.size_mm, metadata.layout_mm.tolist()) == (
        ["x", "y"],
        (400, 300),
        CORNERS_MM.tolist(),
    )
    assert [(one.at_mm, one.across_mm, one.kind) for one in metadata.drawn.supports] == [
        (x, y, "spring") for x in (0, 400) for y in (0, 300)
    ]
    assert metadata.accuracy.ratio < 1.05
    answers = model.estimate(layout.simulate(place_mm, 10, seed=1))
    assert answers["state"].tolist() == ["contact"] * 3
    assert np.abs(stated_mm(answers, AXES) - place_mm).max() < 5
    assert repr(answers).startswith("contact at 98.8 mm (95.9 to 101.7) and 99.7 mm (97.5 to 101.8) with 10.01 N")
    assert " and " in repr(answers)
    found = model.evaluate(draws=64)
    assert found.axis_coverage is not None
    assert found.axis_coverage.keys() == {"x", "y"}
    assert min(one.value for one in found.axis_coverage.values()) > 0.9
    assert "400 by 300 mm" in model.summary()
    with pytest.raises(SceneError, match="knows one axis only"):
        layout.build(estimator="small-network")
