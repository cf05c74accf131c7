"""Runs the model on all samples of a batch in one call. Pure: no clock, no state, no I/O."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.modelfile import Answers, ModelFile, whitening
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.samples import Quality, Sample

Ask = Callable[[NDArray[np.float32], NDArray[np.float32]], Answers]
"""Takes deflections [mm] (samples, channels) and their whitening [1/mm] (samples, channels, channels); returns a value
per output and sample."""
CHUNK = 256
"""Samples in one call of the model. More would cost memory and save no time."""
_FLOAT32_MAX = float(np.finfo(np.float32).max)


@dataclass(frozen=True, slots=True)
class Estimated:
    """One sample and the answer of the model."""

    sequence: int
    acquired_unix_us: int
    bad: dict[str, Quality]
    """Channels that took no part."""
    answer: dict[str, float] | Problem
    """Output name -> value, or the problem if there is no answer."""


def estimate(
    model: ModelFile, surface: str, offered: list[str], samples: Sequence[Sample], ask: Ask | None = None
) -> list[Estimated]:
    """Return the answer of `model` to each sample of `surface`, whose channels come in the order of `offered`.

    `ask` runs the model; by default, `model.estimate` does.
    """
    found: list[Estimated] = []
    for start in range(0, len(samples), CHUNK):
        found += _chunk(model, surface, offered, samples[start : start + CHUNK], ask or model.estimate)
    return found


def _chunk(model: ModelFile, surface: str, offered: list[str], samples: Sequence[Sample], ask: Ask) -> list[Estimated]:
    channels = [(name, offered.index(name)) for name in model.channels]
    max_bad = len(channels) - model.metadata.min_channels
    rows = [arrange(channels, sample) for sample in samples]
    values = np.array([values for values, bad in rows if len(bad) <= max_bad], np.float32)
    valid = np.array([[name not in bad for name, _ in channels] for _, bad in rows if len(bad) <= max_bad], np.bool_)
    answered = iter(_by_sample(ask(values, whitening_of(model, values, valid))) if len(values) else [])
    return [
        Estimated(
            sample.sequence,
            sample.acquired_unix_us,
            bad,
            next(answered) if len(bad) <= max_bad else _too_few(model, surface, bad),
        )
        for sample, (_, bad) in zip(samples, rows, strict=True)
    ]


def whitening_of(model: ModelFile, deflection_mm: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the whitening of settled samples, with the noise that the model was made for and its floor."""
    said = model.metadata
    covariance_mm2 = np.eye(len(said.layout)) * said.noise.sample_mm**2
    exact = deflection_mm.astype(np.float64)
    return whitening(exact, covariance_mm2, said.floor.gain, said.floor.zero_mm, valid).astype(np.float32)


def _by_sample(answers: Answers) -> list[dict[str, float]]:
    columns = [column.tolist() for column in answers.values()]
    return [dict(zip(answers, row, strict=True)) for row in zip(*columns, strict=True)]


def _too_few(model: ModelFile, surface: str, bad: dict[str, Quality]) -> Problem:
    working = len(model.channels) - len(bad)
    named = ", ".join(f"{name} ({quality.value})" for name, quality in bad.items())
    works = "1 channel works" if working == 1 else f"{working} channels work"
    detail = f"Only {works}; the model needs {model.metadata.min_channels}. Check {named}."
    return Problem(Kind.TOO_FEW_CHANNELS, detail, surface, {"bad_channels": dict(bad)})


def arrange(channels: list[tuple[str, int]], sample: Sample) -> tuple[list[float], dict[str, Quality]]:
    """Return the deflections [mm] in the order of the model, and the qualities of channels that are not good.

    `channels` are those of the model: each with its name and its index in the sample.
    """
    values: list[float] = []
    bad: dict[str, Quality] = {}
    for name, place in channels:
        value, quality = sample.deflection_mm[place], sample.quality[place]
        if value is None or quality is not Quality.GOOD:
            bad[name] = quality
        elif abs(value) > _FLOAT32_MAX:
            # Finite as sent but infinite as float32; the answer to that could look like any other.
            bad[name] = Quality.OUT_OF_RANGE
        values.append(0.0 if value is None or name in bad else value)
    return values, bad
