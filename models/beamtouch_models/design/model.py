"""A model for scripts: it answers, is measured beside its accuracy limit, and is saved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import digits
from beamtouch_common.files import write_atomically
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy import evaluation
from beamtouch_models.design.accuracy.evaluation import Evaluation
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.physics.influence_function import InfluenceFunction, check_own
from beamtouch_models.design.pricing.noise import check_scale
from beamtouch_models.design.sweeps import Fraction, TaskMap, in_turn, silent
from beamtouch_models.errors import ModelFileError, SceneError
from beamtouch_models.numbers import array_of, numbers, whole
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.loading import MAX_RATIO, ModelFile


@dataclass(frozen=True, repr=False)
class Model(ModelFile):
    """A model, as `Layout.build` and `load_model` return it.

    `metadata` has its layout, ranges, accuracy and calibration.

    >>> deflection_mm = 10 * influence_matrix(scene, layout.positions_mm, [150])
    >>> answers = model.estimate(deflection_mm)
    >>> {name: float(answers[name][0].round(1)) for name in ("position_low_mm", "position_mm", "position_high_mm")}
    {'position_low_mm': 146.6, 'position_mm': 150.0, 'position_high_mm': 153.5}
    """

    content: bytes
    """Of the model file."""

    def __repr__(self) -> str:
        """Return the name of the model, and what it is good for."""
        layout, accuracy = ", ".join(f"{place:g}" for place in self.metadata.layout_mm), self.metadata.accuracy
        error = f"{digits(accuracy.error_percent, 3)} % of {self.metadata.length_mm:g} mm"
        return f"Model({self.identity}, {self.metadata.estimator}, sensors at {layout} mm, mean error {error})"

    def __reduce__(self) -> tuple[object, tuple[bytes]]:
        """Pickle the content of the file, for processes that load it anew."""
        return load_model, (self.content,)

    def save(self, path: Path | str) -> None:
        """Write the model file, whole or not at all; OSError if that is impossible."""
        write_atomically(Path(path), self.content)

    def estimate(self, deflection_mm: ArrayLike) -> dict[str, Floats]:
        """Return the answers to settled samples of all channels, as the service gives them.

        A settled sample is the mean of so many readings as fit in the latency of the scene, of a beam at rest, with the
        errors of `Surface.errors`; `Layout.simulate` makes such samples.

        Parameters
        ----------
        deflection_mm : (samples, channels) in mm, as the sensors measure them, in the order of the layout; (channels,)
            for one sample

        Returns
        -------
        An array (samples,) per output. `position_mm` is the median of what the sample leaves possible,
        `position_low_mm` to `position_high_mm` hold 95 % of it; likewise `force_n`, `force_low_n` and `force_high_n` if
        the scene asks for a force. `contact_log_odds` is how much likelier a contact makes the sample than rest, as a
        natural logarithm. `misfit` is the squared distance of the sample from the best contact in standard deviations;
        beyond `metadata.thresholds.misfit[-1]` it is not one contact.

        Raises
        ------
        SceneError
            They are not numbers that the sensors can measure, or not one per channel.
        """
        samples, names = np.atleast_2d(array_of(deflection_mm, "deflection_mm")), self.channels
        if samples.ndim != 2 or samples.shape[1] != len(names) or not np.all(np.isfinite(samples)):
            given = f"given: {samples.shape}" if np.all(np.isfinite(samples)) else "given: one that is not finite"
            wanted = f"finite numbers in mm, {len(names)} for each sample: {', '.join(names)}"
            raise SceneError(f"deflection_mm: give {wanted} ({given})")
        if (most_mm := float(np.abs(samples).max(initial=0.0))) > self.largest_mm:
            largest = digits(self.metadata.max_deflection_mm, 3)
            raise SceneError(
                f"deflection_mm: {digits(most_mm, 3)} is more than {MAX_RATIO:g} times the largest deflection of the "
                f"scene, {largest} mm; give it in mm"
            )
        return self.answer(samples)

    def evaluate(
        self,
        *,
        noise_mm: float | None = None,
        draws: int = 20_000,
        seed: int = 0,
        influence: InfluenceFunction | None = None,
        progress: Fraction = silent,
        spread: TaskMap = in_turn,
    ) -> Evaluation:
        """Measure the model beside its accuracy limit, as `design-sensors evaluate` does.

        Parameters
        ----------
        noise_mm : standard deviation of a sample; default: that of the model
        draws, seed : number of simulated contacts, at least, and their seed
        influence : an influence function of your own for the simulated contacts; default: that of the model's scene,
            with the departures of its calibration
        progress, spread : called with the fraction done; maps the tasks, one after the other by default

        Raises
        ------
        SceneError
            The noise is out of proportion to the deflection, or the scene in the model cannot be computed.
        """
        draws, seed, metadata = whole(draws, "draws", 1), whole(seed, "seed", 0), self.metadata
        prior = prior_of_model(metadata)
        if influence is not None:
            check_own(influence, prior.extent.range_mm, prior.force_n, prior.diagonal_mm)
            prior = _with_own(prior, influence, on_axis(metadata.layout_mm), np.array(metadata.departures.gain))
        if noise_mm is not None:
            stated_mm = numbers(noise_mm, "noise_mm", least=0.0)[0]
            check_scale(stated_mm, metadata.max_deflection_mm)
            prior = prior.at_noise(float(stated_mm))
        return evaluation.evaluate(self, prior, draws=draws, seed=seed, progress=progress, spread=spread)


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
    return replace(prior, influence_at=influence_at, variance_at=variance_at if is_uncertain else None)


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
