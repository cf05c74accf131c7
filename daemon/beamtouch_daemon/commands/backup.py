"""`backup`: writes all that makes a gateway into one archive."""

import argparse

from beamtouch_common.archive_commands import end_in_order
from beamtouch_common.archives import Part, write_archive
from beamtouch_common.commands import DONE
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config

PROGRAM = "beamtouch-daemon"


def run(arguments: argparse.Namespace) -> int:
    """Write the archive; raises InputError and FailedError."""
    config = load_config(arguments.config)
    parts = [Part(arguments.config), *_parts_of(config, with_secrets=arguments.with_secrets)]
    with end_in_order():
        names = write_archive(arguments.output, PROGRAM, arguments.config, parts)
    print(*names, sep="\n")
    if not arguments.with_secrets:
        print(f"left out: {config.token_file} (--with-secrets)")
    return DONE


def _parts_of(config: Config, *, with_secrets: bool) -> list[Part]:
    """Return the files of a gateway. Its log and its zeros are of this run of the machine, and of no use after it."""
    passing = {config.log_file, config.zeros_file, config.token_file}
    tares = {config.tare_file(name) for name in config.surfaces}
    files = [path for path in config.files if path not in passing and (path not in tares or path.exists())]
    secrets = [Part(config.token_file, is_secret=True)] if with_secrets else []
    return [*(Part(path) for path in files), *secrets]
