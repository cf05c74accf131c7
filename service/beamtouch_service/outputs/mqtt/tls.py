"""TLS of the connection to the broker."""

import ssl

from beamtouch_service.config import ConfigError
from beamtouch_service.settings import MqttTls


def context(settings: MqttTls) -> ssl.SSLContext:
    """Return the context of a connection; raises ConfigError if a file cannot be used."""
    try:
        made = ssl.create_default_context(cafile=settings.ca)
    except (ssl.SSLError, OSError) as error:
        message = f"{settings.ca}: {_reason(error)}; set mqtt.ca_file to the PEM certificates of the broker's issuer"
        raise ConfigError(message) from None
    if settings.own is None:
        return made
    try:
        # An empty passphrase: otherwise OpenSSL would ask for one at the terminal and wait.
        made.load_cert_chain(settings.own.certificate, settings.own.key, password="")
    except (ssl.SSLError, OSError) as error:
        message = (
            f"{settings.own.certificate} and {settings.own.key} are not a PEM certificate and its key without a "
            f"passphrase ({_reason(error)}); correct mqtt.certificate_file and mqtt.key_file"
        )
        raise ConfigError(message) from None
    return made


def _reason(error: OSError) -> str:
    return "not PEM" if isinstance(error, ssl.SSLError) else str(error.strerror)
