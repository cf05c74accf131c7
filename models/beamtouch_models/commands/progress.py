"""A progress bar on a terminal."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from beamtouch_models import progress


@contextmanager
def shown_progress() -> Iterator[progress.Progress]:
    """Show progress on standard error if that is a terminal; yields the function to report it with."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as display:
        task = display.add_task("", total=1.0)
        yield lambda doing, done: display.update(task, description=doing, completed=done)
