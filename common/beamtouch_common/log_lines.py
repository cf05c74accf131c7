"""Lines of a program's log: a line per event, as text or as JSON, their levels, and a limit on those that repeat."""

import argparse
import json
import logging
import sys
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from time import monotonic
from typing import NamedTuple

REPEAT_S = 60.0
"""Shortest time between two lines with the same reason."""
MAX_REASONS = 100
"""Most reasons that are remembered, so that made-up ones cannot fill the memory. Beyond it, the oldest is forgotten."""


class Repeated:
    """Logs what happens repeatedly to one subject: each reason at once, then once a minute with its count.

    Parameters
    ----------
    logger : receives the lines
    subject : begins each line, as in "press-7: no answer from 10.0.0.1"; empty for none
    every_s : shortest time between two lines with the same reason [s]
    clock : returns the time [s]
    """

    def __init__(
        self,
        logger: logging.Logger,
        subject: str = "",
        *,
        every_s: float = REPEAT_S,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._logger = logger
        self._prefix = f"{subject}: " if subject else ""
        self._every_s = every_s
        self._clock = clock
        self._logged: dict[str, tuple[float, int]] = {}
        """Time of the last line [s] and events since then, by reason, in the order of these times."""
        self._failed_since_s: float | None = None
        self._is_failure_logged = False

    def due(self, reason: str, number: int = 1) -> int:
        """Count events; return how many there were since the last line if one is due, else 0."""
        now_s = self._clock()
        logged_s, pending = self._logged.get(reason, (float("-inf"), 0))
        if now_s - logged_s < self._every_s:
            self._logged[reason] = logged_s, pending + number
            return 0
        self._logged.pop(reason, None)
        if len(self._logged) >= MAX_REASONS:
            del self._logged[next(iter(self._logged))]
        self._logged[reason] = now_s, 0
        return pending + number

    def line_if_due(self, text: str, reason: str = "") -> str:
        """Count an event; return its line, with their number since the last one, if one is due, else an empty text.

        Lines with the same reason have a limit in common; default: those with the same text.
        """
        times = self.due(reason or text)
        if not times:
            return ""
        return f"{text} ({times} times since the last such line)" if times > 1 else text

    def failed(self, text: str, reason: str = "") -> None:
        """Note a failure, and log it if a line is due.

        Parameters
        ----------
        text : The line.
        reason : What its lines have in common; default: all of the text.
        """
        if self._failed_since_s is None:
            self._failed_since_s = self._clock()
        if line := self.line_if_due(text, reason):
            self._logger.warning("%s%s", self._prefix, line)
            self._is_failure_logged = True

    def over(self, words: str = "works again") -> None:
        """Note a success; log after how long, if the failure before it was logged."""
        if self._failed_since_s is not None and self._is_failure_logged:
            self._logger.info("%s%s after %.1f s", self._prefix, words, self._clock() - self._failed_since_s)
        self._failed_since_s, self._is_failure_logged = None, False

    def count(self, number: int, things: str, level: int = logging.WARNING) -> None:
        """Count things such as "samples dropped", and log their number since the last line if a line is due."""
        if number and (total := self.due(things, number)):
            self._logger.log(level, "%s%d %s", self._prefix, total, things)


class RepeatedFilter(logging.Filter):
    """Passes each message of a logger once a minute, because clients can provoke any number of them."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        super().__init__()
        self._repeated = Repeated(logging.getLogger(__name__), clock=clock)

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to write a record. Exceptions are always written."""
        return record.exc_info is not None or self._repeated.due(str(record.msg)) > 0


class TextFormatter(logging.Formatter):
    """Formats an event as one line: the time of this machine's zone with its offset from UTC, level and message."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(message)s")

    def formatTime(self, record: logging.LogRecord, _datefmt: str | None = None) -> str:  # noqa: N802  # the library's
        """Return the time of an event, as in 2026-11-20 23:40:46.123+01:00."""
        return datetime.fromtimestamp(record.created, UTC).astimezone().isoformat(" ", "milliseconds")


class JsonFormatter(logging.Formatter):
    """Formats an event as one JSON object: time (UTC), level, source and message."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        event = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "source": record.name.removeprefix("beamtouch_"),
            "message": record.getMessage(),
        }
        if record.exc_info:
            event["traceback"] = self.formatException(record.exc_info)
        return json.dumps(event)


LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
"""Names of levels, from the most lines to the fewest."""


class Level(NamedTuple):
    """From which level on a part of a program writes lines."""

    part: str
    """The name of its logger: a package, or one of its folders."""
    level: int


def add_level_option(command: argparse.ArgumentParser, package: str, parts: Iterable[str]) -> None:
    """Add the option `--log-level` for a package and these folders of it, whose loggers have the names of modules."""
    names = sorted(parts)

    def level(text: str) -> Level:
        part, equals, name = text.rpartition("=")
        if name not in LEVELS:
            raise argparse.ArgumentTypeError(f"{text!r} must end with one of {', '.join(LEVELS)}")
        if equals and part not in names:
            raise argparse.ArgumentTypeError(f"{text!r} must begin with one of {', '.join(names)}")
        return Level(f"{package}.{part}" if part else package, LEVELS[name])

    words = (
        f"write log lines from this level on: {', '.join(LEVELS)} (default: info). PART=LEVEL sets the level of one "
        f"part: {', '.join(names)}; repeat the option for others"
    )
    command.add_argument("--log-level", metavar="LEVEL", type=level, action="append", default=[], help=words)


def set_up(*, as_json: bool = False, levels: Iterable[Level] = ()) -> None:
    """Send the log of this process to standard error, from level INFO on; of some parts from other levels on."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if as_json else TextFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it logs every failure; its callers report them
    for part, level in levels:
        logging.getLogger(part).setLevel(level)
        if "." not in part:  # all of the program, with the libraries that it uses
            logging.getLogger().setLevel(max(level, logging.INFO))
