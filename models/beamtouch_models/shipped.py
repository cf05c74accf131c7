"""The scenes that come with the distribution: in the package if it is installed, beside it in a checkout."""

from pathlib import Path


def shipped_scenes() -> dict[str, Path]:
    """Return the scene files by name."""
    here = Path(__file__).parent
    folder = next(one for one in (here / "scenes", here.parent / "scenes") if one.is_dir())
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def described(path: Path) -> str:
    """Return the first comment of a scene, which says what it is."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return next((line.lstrip("# ") for line in lines if line.startswith("#")), "")
