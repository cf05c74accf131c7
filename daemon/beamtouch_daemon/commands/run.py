"""`run`: reads all surfaces and publishes their samples until it is stopped."""

import argparse
import asyncio
import dataclasses
import json
import sys
from pathlib import Path

from beamtouch_common.commands import DONE, INTERRUPTED
from beamtouch_common.errors import FailedError
from beamtouch_common.files import require_writable, write_atomically
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.running import daemon
from beamtouch_daemon.running.daemon import Summary


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError if the configuration, or a file that it names, cannot be used."""
    path: Path | None = arguments.summary
    config = load_config(arguments.config, {"token_file": arguments.token_file, "log_file": arguments.sample_log_file})
    require_writable([path], [arguments.config, *config.files])
    summaries, is_interrupted = asyncio.run(daemon.run(config))
    for name, summary in summaries.items():
        _print(name, summary)
    if path:
        content = {"surfaces": {name: dataclasses.asdict(summary) for name, summary in summaries.items()}}
        try:
            write_atomically(path, (json.dumps(content, indent=2) + "\n").encode(), mode=0o644)
        except OSError as error:
            raise FailedError(f"--summary: cannot write {path}: {error.strerror}") from None
    return INTERRUPTED if is_interrupted else DONE


def _print(name: str, summary: Summary) -> None:
    print(
        f"{name}: {summary.readings} readings taken, {summary.readings_lost} lost; "
        f"{summary.samples_published} samples published, {summary.samples_dropped} dropped"
        + (f", {summary.samples_in_log} in the log file for the next start" if summary.samples_in_log else ""),
        file=sys.stderr,
    )
