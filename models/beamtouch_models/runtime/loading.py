"""A model file, loaded: its graph with its metadata, checked before use. `onnx_graph.to_bytes` writes model files."""

import hashlib
import os
import stat
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import ModelFileError
from beamtouch_models.runtime import description
from beamtouch_models.runtime.error_model import whitening
from beamtouch_models.runtime.metadata import INPUTS, THIS_FILE, Metadata
from beamtouch_models.runtime.session import Answers, Graph, GraphError, graph_errors

GOLDEN_TOLERANCE = 1e-3
"""Largest difference between a golden answer and the file's, in mm, N and nats; float32 needs a tenth of it."""

MAX_RATIO = 100.0
"""A deflection is out of range beyond this many times the largest one that the scene allows."""

MAX_BYTES = 4 * 1024 * 1024
"""Largest model file; `design-sensors build` writes at most a hundredth of it."""


@dataclass(frozen=True)
class ModelFile:
    """A loaded model, ready to answer."""

    metadata: Metadata
    identity: str
    """`name@` and the first six hex digits of the file's SHA-256."""
    graph: Graph
    """The graph, which runs in onnxruntime."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.graph.outputs

    @cached_property
    def channels(self) -> list[str]:
        """Channel names in input order."""
        return [channel.name for channel in self.metadata.layout]

    @property
    def largest_mm(self) -> float:
        """Deflection beyond which a channel takes no part: no load goes that far."""
        return MAX_RATIO * self.metadata.max_deflection_mm

    @property
    def lacks(self) -> list[str]:
        """Outputs that are missing: interval, log odds of contact, misfit."""
        return description.lacking(self.metadata, self.outputs)

    def summary(self) -> str:
        """Return the metadata as text, each number with its unit and reference."""
        return description.summary(self.metadata, self.identity, self.outputs)

    def run(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        """Answer any number of samples, of any precision.

        Parameters
        ----------
        deflection_mm : (samples, channels), in the order of the layout, 0 for a channel that is missing
        whitening_per_mm : (samples, channels, channels), as `whitening` returns it

        Returns
        -------
        One float32 array (samples,) per output name.
        """
        return self.graph.run(deflection_mm, whitening_per_mm)

    def answer(self, deflection_mm: Floats, noise_mm: ArrayLike | None = None) -> dict[str, Floats]:
        """Answer samples as the service does, with the floor of the file.

        Parameters
        ----------
        deflection_mm : (samples, channels), as the sensors measure them, in the order of the layout; NaN for a channel
            that is missing
        noise_mm : standard deviations of their noise, which broadcast to the samples; None or 0: that of a settled one

        Returns
        -------
        One array (samples,) per output name.
        """
        floor, noise = self.metadata.floor, np.asarray(0.0 if noise_mm is None else noise_mm, dtype=np.float64)
        noise, valid = np.where(noise == 0, self.metadata.noise.sample_mm, noise), ~np.isnan(deflection_mm)
        covariance_mm2 = np.eye(len(self.channels)) * np.broadcast_to(noise**2, deflection_mm.shape)[:, :, None]
        deflection_mm = np.where(valid, deflection_mm, 0.0)
        answers = self.run(deflection_mm, whitening(deflection_mm, covariance_mm2, floor.gain, floor.zero_mm, valid))
        return {name: values.astype(np.float64) for name, values in answers.items()}


def load(path: Path | str) -> ModelFile:
    """Load a model file and reproduce its golden answers.

    Raises
    ------
    ModelFileError
        The file cannot be read, is too large or damaged, is not a Beamtouch model, or does not give its own golden
        answers.
    """
    return load_bytes(read(path), str(path))


def read(path: Path | str) -> bytes:
    """Read a model file; one that is larger than `MAX_BYTES`, or is not a regular file, is refused unread.

    Raises
    ------
    ModelFileError
        The file cannot be read, is not a regular file, or is too large.
    """
    path = Path(path)
    try:
        # Opening a pipe for reading waits for a writer, unless told otherwise.
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ModelFileError(f"{path}: it is not a regular file; give a model file")
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ModelFileError(f"{path}: {error.strerror}") from None
    except ModelFileError:
        raise
    except ValueError:  # a null character
        raise ModelFileError(f"{str(path)!r} cannot be the path of a file") from None
    if len(content) > MAX_BYTES:
        raise ModelFileError(
            f"{path}: it is larger than {MAX_BYTES >> 20} MiB, so `design-sensors build` did not write it"
        )
    if path.suffix == ".toml":
        raise ModelFileError(f"{path}: this is no model; give the .onnx file that `design-sensors build` wrote")
    return content


def load_bytes(content: bytes, origin: str) -> ModelFile:
    """Load a model from memory; `origin` is named in errors. Raises ModelFileError as `load` does."""
    if not content:
        raise ModelFileError(f"{origin}: the file is empty; build it again with `design-sensors build`")
    try:
        with graph_errors():
            graph = Graph(content)
        metadata = Metadata.from_entries(graph.entries)
        model = ModelFile(metadata, f"{metadata.name}@{hashlib.sha256(content).hexdigest()[:6]}", graph)
        if graph.inputs != INPUTS:
            raise ModelFileError(f"inputs {', '.join(graph.inputs)}; expected {', '.join(INPUTS)}")
        for axis in metadata.axes:
            if f"{axis}_mm" not in graph.outputs:
                raise ModelFileError(f"output {axis}_mm is missing")
        _check_golden(model)
    except GraphError as error:
        reason, why = "damaged or not an ONNX file", "" if "INVALID_PROTOBUF" in str(error) else f" ({error})"
        if "xternal" in str(error) and " data" in str(error):
            reason, why = "its weights are in another file, but a model is one file", ""
        raise ModelFileError(f"{origin}: {reason}; rebuild it with `design-sensors build`{why}") from None
    except ModelFileError as error:
        raise ModelFileError(f"{origin}: {error}".replace(THIS_FILE, origin)) from None
    return model


def _check_golden(model: ModelFile) -> None:
    """Raise ModelFileError unless the graph gives its golden answers, sample by sample as in the service."""
    golden = model.metadata.golden
    try:
        with graph_errors():
            given = [np.array(values, np.float32) for values in (golden.deflection_mm, golden.whitening_per_mm)]
            samples = ([values[index : index + 1] for values in given] for index in range(len(golden.deflection_mm)))
            rows = [model.graph.estimate(*sample) for sample in samples]
            answers = {name: [float(row[name].reshape(())) for row in rows] for name in model.outputs}
    except GraphError as error:
        raise ModelFileError(f"its graph fails on a single sample ({error})") from None
    for name, computed in answers.items():
        expected = golden.answers.get(name, [])
        if len(expected) != len(computed) or not np.allclose(
            computed, expected, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
        ):
            raise ModelFileError(f"its golden answers for {name} are not reproduced on this machine")
