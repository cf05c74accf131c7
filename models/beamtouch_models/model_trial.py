"""A graph tried within bounds of memory and time, before it is used: a small file can ask for any amount of both."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock, Timer
from typing import Any

import onnxruntime as ort

MOST_MEMORY_BYTES = 64 * 1024 * 1024
"""For what a graph computes, of all graphs that are tried at once; one sample of a real model takes less than 1 MiB."""
LIMIT_S = 10.0
"""For all golden answers of a model; those of a real one take milliseconds."""

_NOT_AT_LOADING = ["ConstantFolding"]
"""It would compute what a graph asks for without bounds, before the trial. Real models answer as fast without it."""

_lock = Lock()


_FUNCTIONS_FIELD = 25
"""Of `ModelProto` in onnx.proto."""


def has_functions(content: bytes) -> bool:
    """Say whether an ONNX file defines functions; each may call another twice, and loading would write all of it out.

    What is damaged is left to onnxruntime.
    """
    at = 0
    while at < len(content):
        tag, at = _varint(content, at)
        if tag >> 3 == _FUNCTIONS_FIELD:
            return True
        value, after = _varint(content, at)
        # A number, eight bytes, bytes with their length before them, the begin or end of a group, or four bytes.
        at = {0: after, 1: at + 8, 2: after + value, 3: at, 4: at, 5: at + 4}.get(tag & 7, len(content))
    return False


def _varint(content: bytes, at: int) -> tuple[int, int]:
    """Return the number that begins there (protobuf: seven bits a byte, the low ones first), and where it ends."""
    number = shift = 0
    for byte in content[at : at + 10]:
        number |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:  # the bit that says that another byte follows
            break
    return number, at


def open_session(content: bytes, options: ort.SessionOptions) -> Any:  # noqa: ANN401  # onnxruntime ships no types
    """Return a session that has computed nothing yet."""
    providers = ["CPUExecutionProvider"]
    return ort.InferenceSession(content, options, providers=providers, disabled_optimizers=_NOT_AT_LOADING)


def make_session(content: bytes, options: ort.SessionOptions) -> Any:  # noqa: ANN401  # onnxruntime ships no types
    """Return a session whose memory is bounded; for a trial only, as it shares its memory with other trials."""
    # onnxruntime refuses a second one, and models are loaded in threads.
    with _lock:
        _bound_memory()
    options.add_session_config_entry("session.use_env_allocators", "1")
    return open_session(content, options)


@contextmanager
def limited() -> Iterator[ort.RunOptions]:
    """Give options for runs that end with an error after `LIMIT_S` in all."""
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
    """Make the memory that trials share; onnxruntime keeps one for the process."""
    kind = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    # Grows by what is asked for, from 1 MiB on; the last is the default of onnxruntime.
    ort.create_and_register_allocator(kind, ort.OrtArenaCfg(MOST_MEMORY_BYTES, 1, 1024 * 1024, -1))
