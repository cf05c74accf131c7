"""Parts of several commands: the output folder, the name of the surface, and progress."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Display

from beamtouch_common.errors import InputError
from beamtouch_common.names import name_like
from beamtouch_models.design.sweeps import Progress


def folder_of(path: Path) -> Path:
    """Create the output folder if it is missing; raises InputError if the path is a file."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file; give a folder")
    path.mkdir(parents=True, exist_ok=True)
    return path


def surface_name(scene: Path) -> str:
    """Name the surface after the scene file."""
    return name_like(scene.stem, "surface")


@contextmanager
def shown_progress() -> Iterator[Progress]:
    """Show progress on standard error if that is a terminal; yields the function to report it with."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Display(*columns, console=console, transient=True, disable=not console.is_terminal) as display:
        task = display.add_task("", total=1.0)
        yield lambda doing, done: display.update(task, description=doing, completed=done)


def require_one_axis(axes: Sequence[str], origin: object, command: str) -> None:
    """Raise InputError, which begins with `origin`, if a model has more axes than the command knows."""
    if len(axes) > 1:
        raise InputError(f"{origin}: its axes are {' and '.join(axes)}, and {command} knows models of one axis only")
