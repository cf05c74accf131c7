"""Why there was no answer of the service, in words that say what to change."""

import os
import ssl

import aiohttp


class UnreachableError(Exception):
    """There was no answer; the service may or may not have seen the request.

    Parameters
    ----------
    reason
        What happened, in a few words.
    advice
        What to change; empty if the service may just be away.
    """

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(reason)
        self.advice = advice


_NAME = "publish.url must have a name or address that the certificate states"
_TRUST = "publish.certificate_file must be the service's certificate, or that of its authority"
_CERTIFICATE_ADVICE = {
    9: "check the clock of this machine",  # X509_V_ERR_CERT_NOT_YET_VALID of OpenSSL
    10: "renew it, or check the clock of this machine",  # CERT_HAS_EXPIRED
    18: _TRUST,  # DEPTH_ZERO_SELF_SIGNED_CERT
    19: _TRUST,  # SELF_SIGNED_CERT_IN_CHAIN
    20: _TRUST,  # UNABLE_TO_GET_ISSUER_CERT_LOCALLY
    21: _TRUST,  # UNABLE_TO_VERIFY_LEAF_SIGNATURE
    62: _NAME,  # HOSTNAME_MISMATCH
    64: _NAME,  # IP_ADDRESS_MISMATCH
}


def unreachable(error: aiohttp.ClientError | TimeoutError) -> UnreachableError:
    """Return the error that stands for one of aiohttp."""
    advice = ""
    match error:
        case TimeoutError():
            reason = "timeout"
        case aiohttp.ClientConnectorCertificateError(certificate_error=ssl.SSLCertVerificationError() as refused):
            reason = f"certificate refused: {refused.verify_message.rstrip('.')}"
            advice = _CERTIFICATE_ADVICE.get(refused.verify_code, "")
        case aiohttp.ClientConnectorSSLError():
            reason = "TLS failed"
            advice = "if the service has no certificate, publish.url must begin with http://"
        case aiohttp.ClientConnectorDNSError():
            reason = "no such host is known"
        case aiohttp.ClientConnectorError():
            reason = os.strerror(error.errno) if error.errno else "no connection"
        case aiohttp.ServerDisconnectedError() | aiohttp.ClientOSError() | aiohttp.ClientConnectionResetError():
            reason = "connection closed"
        case aiohttp.ClientPayloadError():
            reason = "the answer broke off"
        case aiohttp.ClientResponseError():
            reason = "the answer is not HTTP"
            advice = "is publish.url the address of another program?"
        case _:
            reason = type(error).__name__
    return UnreachableError(reason, advice)
