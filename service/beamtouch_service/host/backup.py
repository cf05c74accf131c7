"""Writes all that makes a service into one archive: configuration, models, record, and secrets if asked."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from beamtouch_common.archives import Part, write_archive
from beamtouch_common.errors import FailedError
from beamtouch_service.config import Settings
from beamtouch_service.host.rollout import staged_beside
from beamtouch_service.record import RecordAwayError, copy_record

_SECRETS = ("token_file", "password_file", "key_file")
"""Ends of the keys whose files are secrets."""


def back_up(config: Path, settings: Settings, target: Path, *, program: str, with_secrets: bool) -> list[str]:
    """Write the archive; return what to say of it, one line for each file.

    Raises
    ------
    InputError
        There is something at the target.
    FailedError
        A file or the record cannot be read, or the archive cannot be written.
    """
    record = settings.events.file
    named = list(_files_in(settings.model_dump(exclude={"events"})))
    named += [(path, "model") for section in settings.surfaces.values() for path in staged_beside(section.model)]
    # Of a file that several keys name, one is enough: a PEM file may be a certificate with its key, and trusted, too.
    secrets = {path.resolve() for path, key in named if key.endswith(_SECRETS)}
    left_out = set() if with_secrets else {path for path, _ in named if path.resolve() in secrets}
    kept = [path for path, _ in named if path not in left_out]
    parts = [Part(config), *(Part(path, is_secret=path.resolve() in secrets) for path in kept)]
    try:
        with TemporaryDirectory(prefix=".backup-", dir=target.parent) as folder:
            if record is not None:
                copy = Path(folder, "record")
                copy_record(record, copy)
                parts.append(Part(record, copy))
            names = write_archive(target, program, config, parts)
    except RecordAwayError as error:
        raise FailedError(f"{error}; there is no backup") from None
    except OSError as error:
        raise FailedError(f"{target.parent}: {error.strerror}; there is no backup") from None
    lines = [*names, *(f"left out: {path} (--with-secrets)" for path in sorted(left_out))]
    if settings.events.url:
        lines.append("left out: the record in the database of events.url; back it up with pg_dump")
    return lines


def _files_in(settings: object, key: str = "") -> Iterator[tuple[Path, str]]:
    """Give each file that settings name, with its key; of a folder, all files in it, or itself if it has none."""
    if isinstance(settings, dict):
        for name, value in settings.items():
            yield from _files_in(value, str(name))
    elif isinstance(settings, list | tuple):
        for value in settings:
            yield from _files_in(value, key)
    elif isinstance(settings, Path):
        paths = sorted(path for path in settings.rglob("*") if path.is_file()) if settings.is_dir() else []
        yield from ((path, key) for path in paths or [settings])
