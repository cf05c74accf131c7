"""`design-sensors scenes`: lists the shipped scenes, or copies one."""

import argparse
import json
from pathlib import Path

from beamtouch_common.files import write_atomically
from beamtouch_models.commands.new import refuse_existing
from beamtouch_models.errors import SceneError
from beamtouch_models.shipped import described, shipped_scenes


def run(options: argparse.Namespace) -> None:
    """List the scenes with what each is, or copy one into a folder."""
    scenes = shipped_scenes()
    if options.copy:
        target = _copied(scenes, options.copy, force=options.force)
        print(json.dumps({"copied": str(target)}) if options.json else target)
        return
    told = {name: described(path) for name, path in scenes.items()}
    if options.json:
        print(json.dumps({"scenes": told}))
        return
    width = max(map(len, told))
    print("\n".join(f"{name:<{width}}  {text}" for name, text in told.items()))


def _copied(scenes: dict[str, Path], copy: list[str], *, force: bool) -> Path:
    name, folder, *more = [*copy, "."] if len(copy) == 1 else copy
    if more:
        message = f"--copy takes a name and a folder; {more[0]} is one too many"
        raise SceneError(message)
    if name not in scenes:
        message = f"--copy {name}: there is no such scene; choose from {', '.join(scenes)}"
        raise SceneError(message)
    target = Path(folder) / scenes[name].name
    refuse_existing(target, force=force)
    write_atomically(target, scenes[name].read_bytes())
    return target
