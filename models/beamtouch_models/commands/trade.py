"""`design-sensors trade`: measures accuracy against speed, number of sensors and filter."""

import argparse
import math
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from beamtouch_common.errors import InputError
from beamtouch_models.commands.build import surface_name
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.commands.trade_scene import TradedScene
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.estimator import NAMES
from beamtouch_models.progress import Progress
from beamtouch_models.scene import load_scene
from beamtouch_models.trade.front import NotToBeHadError
from beamtouch_models.workers import spread_over


def run(options: argparse.Namespace) -> None:
    """Measure every point of each scene, write the folders, print the fronts, and build the requested points."""
    for option, value in (("--latency-ms", options.latency_ms), ("--error-mm", options.error_mm)):
        if value is not None and not 0 < value < math.inf:
            message = f"{option} {value:g}: give a positive number"
            raise InputError(message)
    # All are loaded first: a mistake in the last scene should not cost the time of the others.
    scenes = [
        TradedScene(path, *load_scene(path), folder, options)
        for path, folder in _folders(options.scene, options.output)
    ]
    for one in scenes:
        for remark in one.remarks:
            print(f"note:    {one.path}: {remark}", file=sys.stderr)
    try:
        with _termination_interrupts():
            _run(scenes, options)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_interrupted(scenes, options.output)) from None


def _run(scenes: Sequence[TradedScene], options: argparse.Namespace) -> None:
    refused: list[str] = []
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        for scene in scenes:
            scene.begin(tuple(options.estimators or NAMES), spread)
        for scene in scenes:
            with _refusals(scenes, scene, refused):
                scene.gather(_named(scene.name, progress))
    # The workers have ended: from here on, times are measured.
    for scene in scenes:
        if scene.is_gathered:
            with _refusals(scenes, scene, refused):
                scene.finish()
    if refused:
        message = f"{len(refused)} of {len(scenes)} scenes are not complete: {'; '.join(refused)}"
        raise InputError(message)


def _named(name: str, progress: Progress) -> Progress:
    """Return a progress whose steps begin with the name of a scene."""
    return lambda doing, done: progress(f"{name}: {doing}", done)


@contextmanager
def _refusals(scenes: Sequence[TradedScene], scene: TradedScene, refused: list[str]) -> Iterator[None]:
    """Note that one of several scenes is refused, and go on with the others; a single one is refused at once."""
    try:
        yield
    except (SceneError, NotToBeHadError) as error:
        if len(scenes) == 1:
            raise
        refused.append(f"{scene.path}: {error}")


def _folders(stated: Path, output: Path) -> list[tuple[Path, Path]]:
    """Return the scenes to measure, each with the folder for its results; makes the folders."""
    if not stated.is_dir():
        return [(stated, output)]
    scenes = sorted(stated.glob("*.toml"))
    if not scenes:
        message = f"{stated}: there are no scenes (*.toml) in this folder"
        raise InputError(message)
    names = [surface_name(path) for path in scenes]
    for path, name in zip(scenes, names, strict=True):
        if names.count(name) > 1:
            message = f"{path}: another scene in this folder would also be called {name}; rename one of them"
            raise InputError(message)
    return [(path, output / name) for path, name in zip(scenes, names, strict=True)]


def _interrupted(scenes: Sequence[TradedScene], output: Path) -> str:
    """Write the kept results, as the interruption may have come between two files; returns the message."""
    done = sum(scene.write_kept() for scene in scenes)
    if not done:
        return "interrupted before the first point; nothing was written"
    return f"interrupted; {done} of {sum(scene.planned for scene in scenes)} points are in {output}"


@contextmanager
def _termination_interrupts() -> Iterator[None]:
    """Treat SIGTERM like Ctrl-C, so that both report what was kept."""

    def interrupt(_signal: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
