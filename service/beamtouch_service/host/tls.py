"""HTTPS: whether the certificate and its key will do, said in one line before anything listens."""

import ssl

from beamtouch_service.config import ConfigError, TlsFiles


def require(files: TlsFiles) -> None:
    """Raise ConfigError unless the files are there, readable, and belong together."""
    for path in (files.certificate, files.key):
        try:
            path.open("rb").close()
        except OSError as error:
            message = f"{path}: {error.strerror}"
            raise ConfigError(message) from None
    try:
        load(ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), files)
    except (ssl.SSLError, OSError):
        message = (
            f"{files.certificate} and {files.key}: no certificate and its key without a passphrase, as PEM; make them "
            "again, or correct server.certificate_file and server.key_file"
        )
        raise ConfigError(message) from None


def load(context: ssl.SSLContext, files: TlsFiles) -> None:
    """Let connections from now on use what the files hold; raises SSLError if they will not do, and changes nothing."""
    # Into a context of no use first: OpenSSL puts the certificate in before it sees that the key is that of another.
    for one in (ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), context):
        # An empty passphrase: OpenSSL would else ask for one at the terminal and wait.
        one.load_cert_chain(files.certificate, files.key, password="")
