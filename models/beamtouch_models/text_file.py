"""Text files that people write: scenes, scripts."""

from pathlib import Path

from beamtouch_models.errors import SceneError

MAX_BYTES = 1024 * 1024
"""A thousand times what a scene takes: more is another file, given by mistake."""


def read_text(path: Path) -> str:
    """Read a text file in UTF-8 of at most `MAX_BYTES`; raises SceneError with the reason in one line."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        text = content.decode()
    except OSError as error:
        message = f"{path}: {error.strerror}"
        raise SceneError(message) from None
    except UnicodeDecodeError:
        message = f"{path}: not a text file in UTF-8"
        raise SceneError(message) from None
    if len(content) > MAX_BYTES:
        message = f"{path}: larger than {MAX_BYTES >> 20} MiB; give a file that was written by hand"
        raise SceneError(message)
    return text
