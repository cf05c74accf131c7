"""Graphs run by onnxruntime: on one thread, with their weights in the same file."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from beamtouch_common.outline import names_of
from beamtouch_models.arrays import Floats, Floats32

Answers = dict[str, Floats32]
"""One array (batch,) per output of a graph."""
Run = Callable[[NDArray[np.floating], NDArray[np.floating]], Answers]
"""Takes deflections in mm (batch, channels) and their whitening in 1/mm (batch, channels, channels)."""


def stated_mm(answers: Mapping[str, NDArray[np.floating]], axes: Sequence[str], end: int = 0) -> Floats:
    """Return places (batch, axes) of answers: those stated, or the low (1) or the high (2) ends of their intervals."""
    return np.stack([answers[names_of(axis, "mm")[end]] for axis in axes], axis=1).astype(np.float64)


CHUNK = 64
"""Samples in one run of a graph, few enough for the cache."""


class GraphError(Exception):
    """A graph cannot be loaded or run; the message is the first line of the reason."""


@contextmanager
def graph_errors() -> Iterator[None]:
    """Raise GraphError in place of any error in a block that loads or runs a graph."""
    try:
        yield
    except Exception as error:  # noqa: BLE001  # onnxruntime's errors have no common base but Exception
        lines = str(error).splitlines()
        raise GraphError(lines[0] if lines else type(error).__name__) from None


def open_session(content: bytes) -> ort.InferenceSession:
    """Return an onnxruntime session of an ONNX file's content, on the CPU, in the thread that asks.

    An answer takes microseconds, and threads that wait for the next one would spin.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 4
    # Without a folder, onnxruntime refuses weights in other files.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    # Its fallback to another device, of which there is none, would print to standard output.
    return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"], enable_fallback=0)


class Graph:
    """An ONNX graph, ready to answer."""

    def __init__(self, content: bytes) -> None:
        """Take an ONNX file's content. Raises errors of onnxruntime, as `estimate` and `run` do; see `graph_errors`."""
        self.session = open_session(content)
        self.inputs = tuple(entry.name for entry in self.session.get_inputs())
        self.outputs = tuple(output.name for output in self.session.get_outputs())
        self.entries: dict[str, str] = self.session.get_modelmeta().custom_metadata_map

    def estimate(self, deflection_mm: Floats32, whitening_per_mm: Floats32) -> Answers:
        """Answer a batch.

        Parameters
        ----------
        deflection_mm : (batch, channels) float32, in the order of the layout, 0 for a channel that is missing
        whitening_per_mm : (batch, channels, channels) float32, as `whitening` returns it

        Returns
        -------
        One float32 array (batch,) per output name.
        """
        values = self.session.run(None, dict(zip(self.inputs, (deflection_mm, whitening_per_mm), strict=True)))
        return dict(zip(self.outputs, values, strict=True))

    def run(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        """Answer any number of samples of any precision, in chunks that fit the cache; otherwise as `estimate`."""
        inputs = deflection_mm.astype(np.float32), whitening_per_mm.astype(np.float32)
        if not len(deflection_mm):  # onnxruntime refuses to multiply no matrices
            return {name: np.empty(0, np.float32) for name in self.outputs}
        chunks = [slice(start, start + CHUNK) for start in range(0, len(deflection_mm), CHUNK)]
        parts = [self.estimate(inputs[0][chunk], inputs[1][chunk]) for chunk in chunks]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def runner(content: bytes) -> Run:
    """Return a function that runs an ONNX file's content on many samples."""
    return Graph(content).run
