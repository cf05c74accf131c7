"""`restore`: restores an archive of `backup`."""

import argparse

from beamtouch_common.archives import restore_archive
from beamtouch_common.commands import DONE


def run(arguments: argparse.Namespace) -> int:
    """Restore an archive, and print where its files are; raises InputError and FailedError."""
    print(*restore_archive(arguments.archive, arguments.folder, arguments.root), sep="\n")
    return DONE
