"""TLS of the connection to the broker."""

import ssl

from beamtouch_common.errors import InputError
from beamtouch_service.outputs.mqtt.section import MqttSection


def context(section: MqttSection) -> ssl.SSLContext:
    """Return the context of a connection; raises InputError if a file cannot be used."""
    try:
        made = ssl.create_default_context(cafile=section.ca_file)
    except (ssl.SSLError, OSError) as error:
        message = (
            f"{section.ca_file}: {_reason(error)}; set mqtt.ca_file to the PEM certificates of the broker's issuer"
        )
        raise InputError(message) from None
    if section.certificate_file is None:
        return made
    try:
        # An empty passphrase: otherwise OpenSSL would ask for one at the terminal and wait.
        made.load_cert_chain(section.certificate_file, section.key_file, password="")
    except (ssl.SSLError, OSError) as error:
        message = (
            f"{section.certificate_file} and {section.key_file} are not a PEM certificate and its key without a "
            f"passphrase ({_reason(error)}); correct mqtt.certificate_file and mqtt.key_file"
        )
        raise InputError(message) from None
    return made


def _reason(error: OSError) -> str:
    return "not PEM" if isinstance(error, ssl.SSLError) else str(error.strerror)
