"""`design-sensors scenes`: lists the shipped scenes, or copies one."""

import argparse
from pathlib import Path

from beamtouch_common.files import require_writable, write_atomically
from beamtouch_models.design.printing import Result
from beamtouch_models.errors import SceneError


def run(options: argparse.Namespace) -> Result:
    """List the scenes with what each is, or copy one into a folder."""
    scenes = shipped_scenes()
    if not options.copy:
        listed = {name: described(path) for name, path in scenes.items()}
        return Result({"scenes": listed}, [list(listed.items())])
    name, folder, *more = [*options.copy, "."] if len(options.copy) == 1 else options.copy
    if more:
        raise SceneError(f"--copy takes a name and a folder; {more[0]} is one too many")
    if name not in scenes:
        raise SceneError(f"--copy {name}: there is no such scene; choose from {', '.join(scenes)}")
    target = Path(folder) / scenes[name].name
    refuse_existing(target, force=options.force)
    write_atomically(target, scenes[name].read_bytes())
    return Result({"copied": str(target)}, [str(target)])


def refuse_existing(target: Path, *, force: bool) -> None:
    """Raise SceneError if a file is there and may not be replaced, InputError if it cannot be written."""
    if target.is_file() and not force:
        raise SceneError(f"{target} exists already; give --force to replace it")
    require_writable([target])


def shipped_scenes() -> dict[str, Path]:
    """Return the scene files by name: in the package if it is installed, beside it in a checkout."""
    package = Path(__file__).parents[1]
    folder = next(candidate for candidate in (package / "scenes", package.parent / "scenes") if candidate.is_dir())
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def described(path: Path) -> str:
    """Return the first comment of a scene, which says what it is."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return next((line.lstrip("# ") for line in lines if line.startswith("#")), "")
