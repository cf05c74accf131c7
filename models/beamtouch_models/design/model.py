"""A model for scripts: it answers, is measured beside its accuracy limit, and is saved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamtouch_common.digits import SHOWN, decimals_of, digits
from beamtouch_common.files import write_atomically
from beamtouch_common.outline import BEAM_AXES, PLATE_AXES, names_of
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy import evaluation
from beamtouch_models.design.accuracy.evaluation import Evaluation
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.physics.influence_function import InfluenceFunction, check_own
from beamtouch_models.design.pricing.noise import check_scale
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.design.sweeps import Fraction, TaskMap, in_turn, silent
from beamtouch_models.errors import ModelFileError, SceneError
from beamtouch_models.numbers import array_of, numbers, whole
from beamtouch_models.places import in_rows, in_words
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.decision.decider import State, state_of
from beamtouch_models.runtime.decision.evidence import LOG_ODDS, Weighed, evidence
from beamtouch_models.runtime.loading import MAX_RATIO, ModelFile
from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, fewest_that_check

PLACES = {axis: names_of(axis, "mm") for axis in (*BEAM_AXES, *PLATE_AXES)}
FIGURES = (*(name for names in PLACES.values() for name in names), *FORCE_OUTPUTS)
"""Outputs that hold in a contact only."""
STATES = "<U11"
"""The type of their names in an array; also if there are none."""
FINENESS = 20
"""Parts of an interval that the decimals of its text show."""


class Estimates(dict[str, NDArray[Any]]):
    """The answers of a model to samples: an array (samples,) by name. Printed, they are a line for each sample.

    `state` is "contact", "clear" or "unexplained" as in the answers of the service, and `channels` is how many channels
    took part. The other names are the outputs of the model, which `Model.estimate` has.

    >>> model.estimate([[0.58, 0.45], [0, 0.0001], [0.7, -0.7]])
    contact at 47.8 mm (42.9 to 52.4); 2 channels hardly tell it from other loads
    clear, nothing touches
    unexplained: not one contact, or a wrong sensor
    """

    def __repr__(self) -> str:
        """Return what is known of each sample."""
        return "\n".join(map(self._told, range(len(next(iter(self.values()))))))

    def _told(self, row: int) -> str:
        """Return what is known of a sample."""
        figures = {name: float(values[row]) for name, values in self.items() if name in FIGURES}
        state = self["state"][row] if "state" in self else State.CONTACT
        if state == State.CLEAR:
            return "clear, nothing touches"
        if state == State.UNEXPLAINED:
            return "unexplained: not one contact, or a wrong sensor"
        places = [_with_interval(figures, axis, "mm") for axis, names in PLACES.items() if names[0] in figures]
        told = f"contact at {' and '.join(places)}"
        if "force_n" in figures:
            told += f" with {_with_interval(figures, 'force', 'n')}"
        few = f"; {self['channels'][row]} channels hardly tell it from other loads"
        return told + (few if self["channels"][row] < fewest_that_check(len(places)) else "")


def _with_interval(figures: dict[str, float], name: str, unit: str) -> str:
    """Return a figure with its interval, if it has one, to the decimals that the interval is worth."""
    value, symbol = figures[f"{name}_{unit}"], unit if unit == "mm" else "N"
    ends = figures.get(f"{name}_low_{unit}"), figures.get(f"{name}_high_{unit}")
    if ends[0] is None or ends[1] is None:
        return f"{digits(value, SHOWN)} {symbol}"
    known = SHOWN - 1 - math.floor(math.log10(max(abs(value), 1.0)))
    decimals = max(min(decimals_of((ends[1] - ends[0]) / FINENESS), known), 0)
    return f"{value:.{decimals}f} {symbol} ({ends[0]:.{decimals}f} to {ends[1]:.{decimals}f})"


class Straightened(NamedTuple):
    """Straight deflections of curved sensors, and their noise."""

    deflection_mm: Floats
    """(samples, channels), NaN beyond the characteristic."""
    noise_mm: Floats
    """(samples, channels) standard deviations."""


@dataclass(frozen=True, repr=False)
class Model(ModelFile):
    """A model, as `Layout.build` and `load_model` return it.

    `metadata` has its layout, ranges, accuracy and calibration.

    >>> deflection_mm = 10 * influence_matrix(scene, layout.positions_mm, [150])
    >>> answers = model.estimate(deflection_mm)
    >>> answers
    contact at 150.0 mm (146.3 to 153.2); 2 channels hardly tell it from other loads
    >>> answers["state"].tolist(), answers["position_mm"].round(1)
    (['contact'], array([150.]))
    """

    content: bytes
    """Of the model file."""

    def __repr__(self) -> str:
        """Return the name of the model, and what it is good for."""
        layout, accuracy = ", ".join(map(in_words, self.metadata.layout_mm)), self.metadata.accuracy
        error = f"{digits(accuracy.error_percent, 3)} % of {self.metadata.diagonal_mm:g} mm"
        return f"Model({self.identity}, {self.metadata.estimator}, sensors at {layout} mm, mean error {error})"

    def __reduce__(self) -> tuple[object, tuple[bytes]]:
        """Pickle the content of the file, for processes that load it anew."""
        return load_model, (self.content,)

    def save(self, path: Path | str) -> None:
        """Write the model file, whole or not at all; OSError if that is impossible."""
        write_atomically(Path(path), self.content)

    def estimate(self, deflection_mm: ArrayLike, *, noise_mm: ArrayLike | None = None) -> Estimates:
        """Return the answers to settled samples, as the service gives them.

        A settled sample is the mean of so many readings as fit in the latency of the scene, of a beam at rest, with the
        errors of `Surface.errors`; `Layout.simulate` makes such samples.

        Parameters
        ----------
        deflection_mm : (samples, channels) in mm, as the sensors measure them, in the order of the layout; (channels,)
            for one sample. NaN: the channel is out, and the others answer without it.
        noise_mm : standard deviations that broadcast to the samples, as the daemon states them; default: that of the
            model

        Returns
        -------
        An array (samples,) by name. `state` is "contact", "clear", or "unexplained": neither rest nor one contact makes
        such a sample. Figures of a contact are NaN if there is none: `position_mm` is the median of what the sample
        leaves possible, `position_low_mm` to `position_high_mm` hold 95 % of it (on two axes `x_mm`, `y_mm` and so on,
        and `place_correlation`, that of the two); likewise `force_n`, `force_low_n` and `force_high_n` if the scene
        asks for a force. `contact_log_odds` is how much likelier a contact makes the sample
        than rest, as a natural logarithm. `misfit` is the squared distance of the sample from the best contact in
        standard deviations. `channels` is how many channels took part. The paper's network gives positions only.

        Raises
        ------
        SceneError
            They are not numbers that the sensors can measure, or not one per channel, or too few channels take part.
        """
        samples, names = np.atleast_2d(array_of(deflection_mm, "deflection_mm")), self.channels
        if samples.ndim != 2 or samples.shape[1] != len(names) or np.any(np.isinf(samples)):
            given = "given: one that is infinite" if np.any(np.isinf(samples)) else f"given: {samples.shape}"
            wanted = f"numbers in {self.metadata.unit}, {len(names)} for each sample: {', '.join(names)}"
            raise SceneError(f"deflection_mm: give {wanted} ({given})")
        valid = ~np.isnan(samples)
        channels = valid.sum(axis=1)
        self._require_channels(int(channels.min(initial=len(names))), "deflection_mm: of a sample")
        if (most_mm := float(np.abs(samples[valid]).max(initial=0.0))) > self.largest_mm:
            largest = digits(self.metadata.max_deflection_mm, 3)
            raise SceneError(
                f"deflection_mm: {digits(most_mm, 3)} is more than {MAX_RATIO:g} times the largest deflection of the "
                f"scene, {largest} {self.metadata.unit}; give it in {self.metadata.unit}"
            )
        noise = array_of(self.metadata.noise.sample_mm if noise_mm is None else noise_mm, "noise_mm")
        if not (np.isfinite(noise) & (noise > 0)).all():
            raise SceneError("noise_mm: give positive standard deviations in " + self.metadata.unit)
        answers: dict[str, NDArray[Any]] = self.answer(samples, noise)
        if LOG_ODDS not in answers:
            return Estimates(answers, channels=channels)
        variance_mm2 = np.broadcast_to(noise**2, samples.shape).copy()
        covariance_mm2 = variance_mm2[:, :, None] * np.eye(len(names))
        weighed = Weighed(np.where(valid, samples, 0.0), covariance_mm2, variance_mm2, valid)
        found = evidence(self.metadata, self.run, weighed)
        state = np.array([state_of(self.metadata.thresholds, one).value for one in found], dtype=STATES)
        for name in FIGURES:
            if name in answers:
                answers[name] = np.where(state == State.CONTACT, answers[name], np.nan)
        return Estimates(answers, state=state, channels=channels)

    def straighten(self, shown_mm: ArrayLike) -> Straightened:
        """Return the straight deflections of what curved sensors show, for `estimate`.

        The daemon does so by the characteristics that `build` writes into its configuration.

        Parameters
        ----------
        shown_mm : (samples, channels) in mm as in the table of the scene, in the order of the layout

        Returns
        -------
        `deflection_mm` and `noise_mm`, (samples, channels) each. The noise is that of a reading of the scene, which a
        steep characteristic enlarges. A channel that shows more than in the table is NaN.

        Raises
        ------
        SceneError
            The sensors of the model are not curved, or the samples do not have its channels.
        """
        surface = resolve_model(self.metadata)
        curves = surface.characteristics_of(self.metadata.layout_mm)
        if not curves:
            raise SceneError("straighten: the sensors of this model are straight; give deflections to `estimate`")
        shown = np.atleast_2d(array_of(shown_mm, "shown_mm"))
        if shown.ndim != 2 or shown.shape[1] != len(self.channels):
            raise SceneError(f"shown_mm: give {len(self.channels)} numbers for each sample (given: {shown.shape})")
        straight = np.column_stack([one.straighten(column) for one, column in zip(curves, shown.T, strict=True)])
        slope = np.column_stack([one.slope(column) for one, column in zip(curves, shown.T, strict=True)])
        noise_mm = (surface.scene.sensors.noise_mm or 0.0) * slope
        return Straightened(straight, np.where(np.isnan(straight), 1.0, noise_mm))

    def _require_channels(self, working: int, where: str) -> None:
        """Raise SceneError, which says `where`, if too few channels take part."""
        if working < (least := self.metadata.min_channels):
            raise SceneError(
                f"{where}, {working} of {len(self.channels)} channels take part, but the model needs {least}"
            )

    def evaluate(
        self,
        *,
        noise_mm: float | None = None,
        draws: int = 20_000,
        seed: int = 0,
        missing: Sequence[str] = (),
        influence: InfluenceFunction | None = None,
        progress: Fraction = silent,
        spread: TaskMap = in_turn,
    ) -> Evaluation:
        """Measure the model beside its accuracy limit, as `design-sensors evaluate` does.

        Parameters
        ----------
        noise_mm : standard deviation of a sample; default: that of the model
        draws, seed : number of simulated contacts, at least, and their seed
        missing : names of channels that are out; the limit is then that of the others
        influence : an influence function of your own for the simulated contacts; default: that of the model's scene,
            with the departures of its calibration
        progress, spread : called with the fraction done; maps the tasks, one after the other by default

        Raises
        ------
        SceneError
            The noise is out of proportion to the deflection, a channel that is missing is none of the model's or leaves
            too few, or the scene in the model cannot be computed.
        """
        draws, seed, metadata = whole(draws, "draws", 1), whole(seed, "seed", 0), self.metadata
        prior = prior_of_model(metadata)
        if isinstance(missing, str) or (unknown := set(missing) - set(self.channels)):
            given = repr(missing) if isinstance(missing, str) else ", ".join(map(str, unknown))
            raise SceneError(f"missing: give a list of some of {', '.join(self.channels)} (given: {given})")
        out = [place for place, channel in enumerate(self.channels) if channel in missing]
        self._require_channels(len(self.channels) - len(out), f"missing: without {', '.join(missing)}")
        if influence is not None:
            check_own(influence, prior.extent.ranges_mm, prior.force_n, np.array(metadata.size_mm))
            sensor_mm = in_rows(metadata.layout_mm, prior.extent.axes)
            prior = _with_own(prior, influence, sensor_mm, np.array(metadata.departures.gain))
        if noise_mm is not None:
            stated_mm = numbers(noise_mm, "noise_mm", least=0.0)[0]
            check_scale(stated_mm, metadata.max_deflection_mm, metadata.unit)
            prior = prior.at_noise(float(stated_mm))
        return evaluation.evaluate(self, prior, draws=draws, seed=seed, missing=out, progress=progress, spread=spread)


def _with_own(prior: Prior, influence: InfluenceFunction, sensor_mm: Floats, gain: Floats) -> Prior:
    """Return a prior with another influence on the same sensors (channels, axes), behind their gains (channels,)."""

    def influence_at(place_mm: Floats) -> Floats:
        matrix: Floats = gain * influence.at(sensor_mm, place_mm)
        return matrix

    def variance_at(place_mm: Floats) -> Floats:
        variance: Floats = gain**2 * influence.variance(sensor_mm, place_mm, mounting_mm)
        return variance

    # A calibration has found the places of the sensors.
    mounting_mm = prior.errors.mounting_mm if prior.variance_at is not None else 0.0
    is_uncertain = influence.is_uncertain(mounting_mm)
    return replace(
        prior,
        influence_at=influence_at,
        variance_at=variance_at if is_uncertain else None,
        shared=influence.shared(sensor_mm),
    )


def load_model(model: Path | str | bytes) -> Model:
    """Load a model from the path of a file, or the content of one, and reproduce its golden answers.

    Raises
    ------
    ModelFileError
        The file cannot be read, or it is not a model that can be used.

    Examples
    --------
    >>> load_model("strip.onnx").identity == model.identity
    True
    """
    if not isinstance(model, Path | str | bytes):
        raise ModelFileError(f"the model: give a path or the content of a file, not {type(model).__name__}")
    content, origin = (model, "the model") if isinstance(model, bytes) else (loading.read(model), str(model))
    loaded = loading.load_bytes(content, origin)
    return Model(loaded.metadata, loaded.identity, loaded.graph, content)
