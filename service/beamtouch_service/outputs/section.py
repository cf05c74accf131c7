"""The contract of an output: its section in the configuration, and what is made from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from beamtouch_service.sections import Section

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from beamtouch_service.api.context import Context


class OutputSection(Section):
    """One output. A subclass in the folder of the output states the keys of its section."""

    name: ClassVar[str]
    """Name of the section."""
    module: ClassVar[str]
    """The module with `make(section, surfaces, access)`, which returns an `Output` for surfaces of these names and for
    these tokens. It raises InputError if the output can never work like this, and FailedError if a file cannot be read:
    it may come later."""
    extra: ClassVar[str]
    """The extra of the distribution that brings the libraries of that module."""
    not_shared: ClassVar[str] = ""
    """Why the output does not work with a record of events that several services share."""


@dataclass(frozen=True)
class Output:
    """Another way to the contacts than HTTP."""

    run: Callable[[Context], Coroutine[Any, Any, None]]
    """Serves one application until cancelled."""
    warnings: list[str]
    """Warnings: settings that work, but may not be meant."""
