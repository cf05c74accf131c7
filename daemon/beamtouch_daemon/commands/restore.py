"""`restore`: restores an archive of `backup`."""

import argparse

from beamtouch_common.archive_commands import end_in_order
from beamtouch_common.archives import restore_archive
from beamtouch_common.commands import DONE


def run(arguments: argparse.Namespace) -> int:
    """Restore an archive, and print where its files are; raises InputError and FailedError."""
    with end_in_order():
        restored = restore_archive(arguments.archive, arguments.folder, arguments.root)
    print(*restored, sep="\n")
    return DONE
