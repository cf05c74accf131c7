"""The command `beamtouch-service`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from beamtouch_service import version
from beamtouch_service.config import ConfigError, load_settings

PROGRAM = "beamtouch-service"
EXIT_DONE, EXIT_FAILED, EXIT_WRONG_INPUT = 0, 1, 2

_EXTRA = {"fastapi", "uvicorn", "starlette", "onnxruntime", "numpy"}


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_WRONG_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(PROGRAM, description="Takes samples, gives the contact, over HTTP.")
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version.current()}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run = commands.add_parser("run", help="serve until stopped", description="Serves until SIGTERM or Ctrl-C.")
    run.add_argument("--model", metavar="MODEL", help="model file; alone, it makes one surface of the model's name")
    run.add_argument("--config", metavar="FILE", help="TOML file with [server] and [surfaces.NAME]")
    run.add_argument("--host", help="address to listen on (127.0.0.1); beyond loopback only with a token")
    run.add_argument("--port", type=int, help="port to listen on (8420); 0 picks a free one")
    run.add_argument("--token-file", metavar="FILE", help="bearer token that writes must bear; none: no writes")
    run.add_argument("--stale-ms", type=float, metavar="N", help="oldest sample to answer from, in ms (500)")
    return parser


def _run(arguments: argparse.Namespace) -> None:
    options = {name: getattr(arguments, name) for name in ("model", "host", "port", "token_file", "stale_ms")}
    settings = load_settings(Path(arguments.config) if arguments.config else None, options)
    # Only now: what needs the extra is not needed to say that a config is wrong, or that the extra is missing.
    from beamtouch_service import server  # noqa: PLC0415

    server.run(settings)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return 0 done, 1 failed, 2 wrong input with one line on standard error."""
    arguments = _parser().parse_args(argv)
    try:
        _run(arguments)
    except ConfigError as error:
        return _refuse(str(error))
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _EXTRA:
            raise
        return _refuse(f"{error.name} is not installed; pip install 'beamtouch[service]'")
    except KeyboardInterrupt:
        return EXIT_DONE
    return EXIT_DONE


def _refuse(message: str) -> int:
    print(f"{PROGRAM}: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_WRONG_INPUT


if __name__ == "__main__":
    sys.exit(main())
