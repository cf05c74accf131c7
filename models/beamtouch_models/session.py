"""onnxruntime sessions: one thread, weights in the same file, and bounded trials of graphs that are not trusted yet."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from threading import Lock, Timer

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats32

Answers = dict[str, Floats32]
"""One array (batch,) per output of a graph."""
Run = Callable[[NDArray[np.floating], NDArray[np.floating]], Answers]
"""Takes deflections in mm (batch, channels) and their whitening in 1/mm (batch, channels, channels)."""

CHUNK = 64
"""Samples in one run of a graph, few enough for the cache."""
MAX_MEMORY_BYTES = 64 * 1024 * 1024
"""Memory that all graphs on trial share for intermediate results; a sample of a real model takes under 1 MiB."""
LIMIT_S = 10.0
"""Time for all golden answers of a model; those of a real model take milliseconds."""

_NOT_AT_LOADING = ["ConstantFolding"]
"""It would compute parts of a graph when the graph is loaded, without bounds. Real models answer as fast without it."""
_FUNCTIONS_FIELD = 25
"""Number of the field `functions` of `ModelProto` in onnx.proto."""

_lock = Lock()


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


def open_session(content: bytes, options: ort.SessionOptions | None = None) -> ort.InferenceSession:
    """Return an onnxruntime session of an ONNX file's content, on the CPU, which has computed nothing yet."""
    providers = ["CPUExecutionProvider"]
    return ort.InferenceSession(
        content, options or session_options(), providers=providers, disabled_optimizers=_NOT_AT_LOADING
    )


def open_trial(content: bytes) -> ort.InferenceSession:
    """Return a session with bounded memory, which it shares with all other trials."""
    # Models are loaded in threads, and onnxruntime refuses a second allocator.
    with _lock:
        _bound_memory()
    options = session_options()
    options.add_session_config_entry("session.use_env_allocators", "1")
    return open_session(content, options)


def has_functions(content: bytes) -> bool:
    """Return whether an ONNX file defines functions: each may call another twice, and loading would expand all calls.

    A damaged file is left to onnxruntime.
    """
    at = 0
    while at < len(content):
        tag, at = _varint(content, at)
        if tag >> 3 == _FUNCTIONS_FIELD:
            return True
        value, after = _varint(content, at)
        # By wire type: a number, eight bytes, bytes after their length, the begin or end of a group, four bytes.
        at = {0: after, 1: at + 8, 2: after + value, 3: at, 4: at, 5: at + 4}.get(tag & 7, len(content))
    return False


def _varint(content: bytes, at: int) -> tuple[int, int]:
    """Return the number that begins there (protobuf: seven bits a byte, the low ones first), and where it ends."""
    number = shift = 0
    for byte in content[at : at + 10]:
        number |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:  # the high bit says that another byte follows
            break
    return number, at


def session_options() -> ort.SessionOptions:
    """Return options for one thread that does not spin: an answer takes microseconds, and waiting must cost nothing."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4
    # Without a folder, onnxruntime refuses weights in other files.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    return options


def runner(content: bytes) -> Run:
    """Return a function that runs an ONNX file's content on many samples."""
    session = open_session(content)
    names = [output.name for output in session.get_outputs()]
    inputs = [entry.name for entry in session.get_inputs()]

    def answer(*values: Floats32) -> Answers:
        return dict(zip(names, session.run(None, dict(zip(inputs, values, strict=True))), strict=True))

    return partial(run_in_chunks, answer)


def run_in_chunks(
    answer: Callable[[Floats32, Floats32], Answers],
    deflection_mm: NDArray[np.floating],
    whitening_per_mm: NDArray[np.floating],
) -> Answers:
    """Return the answers of a graph to many samples, in chunks that fit the cache.

    Parameters
    ----------
    answer : runs the graph on a batch
    deflection_mm : (samples, channels); there may be none
    whitening_per_mm : (samples, channels, channels)
    """
    inputs = deflection_mm.astype(np.float32), whitening_per_mm.astype(np.float32)
    chunks = [slice(start, start + CHUNK) for start in range(0, max(1, len(deflection_mm)), CHUNK)]
    parts = [answer(inputs[0][chunk], inputs[1][chunk]) for chunk in chunks]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@contextmanager
def limited() -> Iterator[ort.RunOptions]:
    """Yield options for runs that end with an error once they have taken `LIMIT_S` together."""
    options = ort.RunOptions()
    timer = Timer(LIMIT_S, setattr, (options, "terminate", True))
    timer.daemon = True
    timer.start()
    try:
        yield options
    finally:
        timer.cancel()


@cache
def _bound_memory() -> None:
    """Create the memory that trials share; onnxruntime keeps one for the process."""
    kind = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    # The arena starts at 1 MiB and grows by what is asked for; -1 keeps onnxruntime's default.
    ort.create_and_register_allocator(kind, ort.OrtArenaCfg(MAX_MEMORY_BYTES, 1, 1024 * 1024, -1))
