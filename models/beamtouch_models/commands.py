"""What each command of `design-sensors` does: read files, call the pure parts, print, write."""

import argparse
import json
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from beamtouch_models import modelfile, report
from beamtouch_models.build import Progress as Report
from beamtouch_models.build import build
from beamtouch_models.daemon_config import daemon_config, write_token_if_absent
from beamtouch_models.errors import SceneError
from beamtouch_models.export import write_whole
from beamtouch_models.scene import load_scene


def run(options: argparse.Namespace) -> int:
    """Run the command that `cli` parsed; returns the exit code."""
    try:
        {"build": _build, "inspect": _inspect}[options.command](options)
    except (SceneError, modelfile.ModelFileError) as error:
        return _fail(error, 2)
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}", 2)
    except KeyboardInterrupt:
        return _fail("interrupted; nothing was written", 1)
    return 0


def _build(options: argparse.Namespace) -> None:
    scene, text = load_scene(options.scene)
    for path in (options.output, options.daemon_config):
        if path is not None and not path.parent.is_dir():
            message = f"{path.parent}: no such folder; make it first"
            raise SceneError(message)
    with _progress() as progress:
        built = build(
            scene, text, _surface_name(options.scene), count=options.sensors, seed=options.seed, progress=progress
        )
    write_whole(options.output, built.content)
    if options.daemon_config is not None:
        write_whole(options.daemon_config, daemon_config(built.metadata).encode())
        token = write_token_if_absent(options.daemon_config.parent)
        print(
            f"try it:  beamtouch-rig {options.scene} --model {options.output} --modbus-tcp 127.0.0.1:5020\n"
            f"         beamtouch-service run --model {options.output} --token-file {token}\n"
            f"         beamtouch-daemon run {options.daemon_config}",
            file=sys.stderr,
        )
    _print(modelfile.load_bytes(built.content, str(options.output)), as_json=options.json)


def _inspect(options: argparse.Namespace) -> None:
    _print(modelfile.load(options.model), as_json=options.json)


def _print(model: modelfile.ModelFile, *, as_json: bool) -> None:
    print(json.dumps(report.describe(model)) if as_json else report.summary(model))


def _surface_name(scene: Path) -> str:
    """Name the surface after the scene file."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", scene.stem)[:64] or "surface"


@contextmanager
def _progress() -> Iterator[Report]:
    """Show progress on stderr if that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as display:
        task = display.add_task("", total=1.0)
        yield lambda doing, done: display.update(task, description=doing, completed=done)


def _fail(reason: object, code: int) -> int:
    print(f"design-sensors: {reason}", file=sys.stderr)
    return code
