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

_lock = Lock()


def make_session(content: bytes, options: ort.SessionOptions) -> Any:  # noqa: ANN401  # onnxruntime ships no types
    """Return a session whose memory is bounded; for a trial only, as it shares its memory with other trials."""
    # onnxruntime refuses a second one, and models are loaded in threads.
    with _lock:
        _bound_memory()
    options.add_session_config_entry("session.use_env_allocators", "1")
    return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])


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
