"""Failures of a connection to a broker: their kinds, and their reasons in words that say what to do. Pure."""

import ssl

NO_ANSWER, LOST = "it does not answer", "the connection is lost"
_ACCOUNT = "check mqtt.username and mqtt.password_file"
_OTHER_BROKER = "use a broker that does"
_IN_OUR_WORDS = {
    "Unspecified error": LOST,
    "Keep alive timeout": NO_ANSWER,
    "Bad user name or password": f"it refuses the user name or the password; {_ACCOUNT}",
    "Not authorized": f"it refuses this client: not authorized; {_ACCOUNT}, and the rights of this user",
    "Unsupported protocol version": f"it does not speak MQTT 5; {_OTHER_BROKER}",
    "QoS not supported": f"it does not take messages of QoS 1; {_OTHER_BROKER}",
    "Retain not supported": f"it does not retain messages; {_OTHER_BROKER}",
    "Packet too large": "it takes no messages of this size; raise its limit to 64 KiB or more",
    "Client identifier not valid": "it refuses the client identifier; correct mqtt.client_id",
    "Use another server": "it says that another broker is to be used; correct mqtt.host",
    "Server moved": "it says that the broker has moved; correct mqtt.host",
    "Protocol error": "its answers are not MQTT 5; are mqtt.host and mqtt.port those of a broker that speaks it?",
    "Session taken over": "another client has the same mqtt.client_id; each service needs a prefix of its own",
}
"""Names of reason codes in the standard -> words for the log."""
_NOT_YET_VALID, _EXPIRED = 9, 10
"""Error codes of OpenSSL for certificates."""


class BrokerError(Exception):
    """There is no connection; the text says why."""


class RefusedError(BrokerError):
    """The broker refused the client, or a message; the text is its reason."""


def words_for(reason: str) -> str:
    """Return the words for the name of a reason code."""
    return _IN_OUR_WORDS.get(reason, reason)


def reason_of(error: OSError) -> str:
    """Return why no connection could be made."""
    if isinstance(error, TimeoutError):
        return NO_ANSWER
    if isinstance(error, ssl.SSLCertVerificationError):
        is_of_time = error.verify_code in {_NOT_YET_VALID, _EXPIRED}
        advice = "renew it, or check the clock of this machine" if is_of_time else "check mqtt.ca_file"
        return f"certificate verify failed: {error.verify_message.rstrip('.')}; {advice}"
    return str(error) if isinstance(error, ssl.SSLError) else error.strerror or str(error)
