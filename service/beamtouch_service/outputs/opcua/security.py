"""The security of the OPC UA server: certificates, the user, and a server that is only read.

Files are told apart by their content. The library goes by their names: it takes `own.key` for DER, and passes over
`client.crt` in a folder of trusted certificates.
"""

import hmac
import logging
from dataclasses import dataclass
from pathlib import Path

from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.truststore import TrustStore
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.x509 import Certificate, verification

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import read_bounded
from beamtouch_common.log_lines import Repeated
from beamtouch_common.secrets import read_password
from beamtouch_service.outputs.opcua.section import OpcUaSection
from beamtouch_service.outputs.opcua.subscriptions import OwnSubscriptions

ENCRYPTED = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
]

NOBODY = User(role=UserRole.Anonymous)


class TrustedCertificates(TrustStore):  # type: ignore[misc]  # mypy skips the types of the library
    """Certificates of clients, and of issuers of such."""

    def __init__(self, certificates: list[Certificate]) -> None:
        super().__init__([], [])
        self._certificates = verification.Store(certificates)
        self._repeated = Repeated(logging.getLogger(__name__))

    def is_trusted(self, certificate: Certificate) -> bool:
        """Return whether a certificate is one of these, or was issued by one of them."""
        verifier = self.policy_builder.store(self._certificates).build_client_verifier()
        try:
            verifier.verify(certificate, [])
        except verification.VerificationError as error:
            words = "OPC UA server: a client is refused, as its certificate is not trusted"
            advice = "if it is in opcua.trusted_folder, check the clock of this machine, and restart the service"
            self._repeated.failed(f"{words}: {error}; {advice}")
            return False
        return True


class Clients:
    """Lets those read that have a trusted certificate and the password of the one user, as far as these are asked for.

    The certificate is that with which the client has encrypted the connection. By itself, the library looks at the one
    that the client names when it begins a session, which may be none, or somebody else's. Nor does it refuse a
    connection without encryption, which has no certificate.
    """

    def __init__(
        self, name: str | None, password: str | None, trusted: TrustedCertificates | None, *, are_encrypted: bool
    ) -> None:
        self._name, self._password, self._trusted = name or "", password, trusted
        self._are_encrypted = are_encrypted

    def get_user(
        self,
        iserver: object,
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Return the user; None refuses the session, and so does ServiceError for a certificate that is not trusted."""
        del iserver
        if self._are_encrypted and not certificate:
            raise ServiceError(ua.StatusCodes.BadSecurityModeRejected)
        if self._trusted and not (certificate and self._trusted.is_trusted(uacrypto.x509_from_der(certificate))):
            raise ServiceError(ua.StatusCodes.BadCertificateUntrusted)
        given, held = f"{username or ''}\n{password or ''}", f"{self._name}\n{self._password}"
        if self._password is not None and not hmac.compare_digest(given.encode(), held.encode()):
            return None
        return User(role=UserRole.User)


class OwnSession(InternalSession):  # type: ignore[misc]  # mypy skips the types of the library
    """A session whose subscriptions end with it, also if the client would leave them to others."""

    async def close_session(self, delete_subs: bool = True) -> None:
        """End the session."""
        del delete_subs
        await super().close_session(delete_subs=True)


class ReadOnlyServer(InternalServer):  # type: ignore[misc]  # mypy skips the types of the library
    """A server to which clients add nothing, and whose sessions end with their connections.

    The library takes other servers into its list from anyone.
    """

    def create_session(self, name: str, user: User = NOBODY, external: bool = False) -> InternalSession:
        """Begin a session that reaches no subscription but its own, and that no other connection can use.

        The library keeps `external` ones for minutes after their connection was lost, with their subscriptions. By
        their numbers, which are easily guessed, it lets others use them before it has seen who asks. A client that has
        lost its connection begins a new session.
        """
        del external
        session = OwnSession(self, self.aspace, self.subscription_service, name, user=user)
        session.subscription_service = OwnSubscriptions(self.subscription_service, session.session_id)
        return session

    def register_server(self, server: object, conf: object = None) -> None:
        """Refuse to take a server into that list."""
        del server, conf
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


@dataclass(frozen=True)
class Security:
    """The protection of the server, as read from its files."""

    clients: Clients
    has_password: bool
    has_trusted: bool
    """True if only clients with certain certificates may connect."""
    own: tuple[Certificate, RSAPrivateKey] | None
    """Certificate and key; without them, connections are not encrypted."""

    def apply(self, server: Server) -> None:
        """Let a server that does not listen yet ask for the user and the certificates."""
        server.set_identity_tokens([ua.UserNameIdentityToken if self.has_password else ua.AnonymousIdentityToken])
        server.set_security_policy(ENCRYPTED if self.own else [ua.SecurityPolicyType.NoSecurity])
        if self.own:
            server.iserver.certificate, server.iserver.private_key = self.own


async def read_security(section: OpcUaSection) -> Security:
    """Read the files of a section.

    Raises
    ------
    InputError
        A file is no certificate, key or password.
    FailedError
        A file cannot be read, or the folder of trusted certificates is empty.
    """
    password = read_password(section.password_file) if section.password_file else None
    own: tuple[Certificate, RSAPrivateKey] | None = None
    trusted: TrustedCertificates | None = None
    if section.certificate_file and section.key_file:
        own = (await _read_certificate(section.certificate_file), await _read_key(section.key_file))
        if own[0].public_key() != own[1].public_key():
            raise InputError(f"{section.key_file}: not the key of {section.certificate_file}; correct [opcua]")
    if folder := section.trusted_folder:
        paths = sorted(folder.glob("*")) if folder.is_dir() else []
        if not paths:
            message = (
                f"{folder}: no certificates of clients in it; set opcua.trusted_folder to a folder of PEM or DER files"
            )
            raise FailedError(message)  # they may come yet: a folder is empty until it is mounted
        trusted = TrustedCertificates([await _read_certificate(path) for path in paths])
    clients = Clients(section.username, password, trusted, are_encrypted=own is not None)
    return Security(clients, password is not None, trusted is not None, own)


async def _read_certificate(path: Path) -> Certificate:
    content, kind = _read(path)
    try:
        certificate: Certificate = await uacrypto.load_certificate(content, kind)
    except ValueError as error:
        raise InputError(f"{path}: not a PEM or DER certificate ({error}); correct [opcua]") from None
    return certificate


async def _read_key(path: Path) -> RSAPrivateKey:
    content, kind = _read(path)
    try:
        key = await uacrypto.load_private_key(content, None, kind)
    except (ValueError, TypeError) as error:
        message = f"{path}: not a PEM or DER private key without a passphrase ({error}); correct [opcua]"
        raise InputError(message) from None
    if not isinstance(key, RSAPrivateKey):
        raise InputError(f"{path}: not an RSA key, which the security policies of OPC UA need; correct [opcua]")
    return key


def _read(path: Path) -> tuple[bytes, str]:
    """Return the content of a file, and its kind as the library calls it; raises InputError and FailedError."""
    try:
        content = read_bounded(path)
    except OSError as error:
        raise FailedError(f"{path}: {error.strerror}") from None
    return content, "pem" if b"-----BEGIN" in content else "der"
