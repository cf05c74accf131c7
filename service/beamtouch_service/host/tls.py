"""HTTPS: checks the certificate and its key before the service listens."""

import ssl

from beamtouch_common.errors import FailedError
from beamtouch_service.config import ConfigError
from beamtouch_service.settings import TlsFiles


def require(files: TlsFiles) -> None:
    """Raise FailedError unless the files can be read, and ConfigError unless they belong together."""
    for path in (files.certificate, files.key):
        try:
            path.open("rb").close()
        except OSError as error:
            message = f"{path}: {error.strerror}"
            raise FailedError(message) from None
    try:
        load(ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), files)
    except (ssl.SSLError, OSError):
        message = (
            f"{files.certificate} and {files.key} are not a PEM certificate and its key without a "
            "passphrase; create them again, or correct server.certificate_file and server.key_file"
        )
        raise ConfigError(message) from None


def load(context: ssl.SSLContext, files: TlsFiles) -> None:
    """Use these files for new connections; raises SSLError and changes nothing if they cannot be used."""
    # Try a throwaway context first: OpenSSL replaces the certificate before it notices that the key does not match.
    for one in (ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), context):
        # An empty passphrase: otherwise OpenSSL would ask for one at the terminal and wait.
        one.load_cert_chain(files.certificate, files.key, password="")
