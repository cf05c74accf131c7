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

_EXTRA = {"fastapi", "uvicorn", "starlette", "onnxruntime", "numpy", "prometheus_client"}
_OPTIONS = (
    "model",
    "host",
    "port",
    "token_file",
    "read_token_file",
    "admin_token_file",
    "certificate_file",
    "key_file",
    "stale_ms",
)


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
    run.add_argument("--host", help="address to listen on (127.0.0.1); beyond loopback only with tokens")
    run.add_argument("--port", type=int, help="port to listen on (8420); 0 picks a free one")
    run.add_argument("--token-file", metavar="FILE", help="bearer token that writes must bear; none: no writes")
    run.add_argument("--read-token-file", metavar="FILE", help="token that reads must bear; none: all of this machine")
    run.add_argument("--admin-token-file", metavar="FILE", help="token for administration; none: nobody")
    run.add_argument("--certificate-file", metavar="FILE", help="PEM, with --key-file: HTTPS instead of HTTP")
    run.add_argument("--key-file", metavar="FILE", help="PEM, the key of the certificate")
    run.add_argument("--stale-ms", type=float, metavar="N", help="oldest sample to answer from, in ms (500)")
    check = commands.add_parser("check", help="say what a model file is", description="Says what a model file is.")
    check.add_argument("model", metavar="MODEL", help="model file, from `design-sensors build`")
    check.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _check(arguments: argparse.Namespace) -> None:
    from beamtouch_service import check  # noqa: PLC0415  # as in _run

    print(check.report(Path(arguments.model), as_json=arguments.json))


def _run(arguments: argparse.Namespace) -> None:
    options = {name: getattr(arguments, name) for name in _OPTIONS}
    settings = load_settings(Path(arguments.config) if arguments.config else None, options)
    # Only now: what needs the extra is not needed to say that a config is wrong, or that the extra is missing.
    from beamtouch_service.host import server  # noqa: PLC0415

    server.run(settings)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return 0 done, 1 failed, 2 wrong input with one line on standard error."""
    arguments = _parser().parse_args(argv)
    try:
        {"run": _run, "check": _check}[arguments.command](arguments)
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
