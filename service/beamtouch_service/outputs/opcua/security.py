"""Who may connect to the OPC UA server: its certificate, the certificates of clients, and the user.

Files are told apart by their content. They are read when the service starts.
"""

import hmac
import logging
from dataclasses import dataclass
from pathlib import Path

from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.user_managers import UserManager
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_der_private_key,
    load_pem_private_key,
)
from cryptography.x509 import (
    BasicConstraints,
    Certificate,
    load_der_x509_certificate,
    load_pem_x509_certificate,
    verification,
)

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import read_bounded
from beamtouch_common.log_lines import Repeated
from beamtouch_common.secrets import read_password
from beamtouch_service.outputs.opcua.door import Door
from beamtouch_service.outputs.opcua.section import OpcUaSection

_ENCRYPTED = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
]


class TrustedCertificates:
    """Certificates of clients, and of issuers of such."""

    def __init__(self, certificates: list[Certificate]) -> None:
        issuers = verification.ExtensionPolicy.permit_all().require_present(
            BasicConstraints, verification.Criticality.AGNOSTIC, _require_issuer
        )
        policy = verification.PolicyBuilder().extension_policies(
            ca_policy=issuers, ee_policy=verification.ExtensionPolicy.permit_all()
        )
        self._policy = policy.store(verification.Store(certificates))
        self._repeated = Repeated(logging.getLogger(__name__))

    def is_trusted(self, certificate: Certificate) -> bool:
        """Return whether a certificate is one of these, or was issued by one of them."""
        try:
            self._policy.build_client_verifier().verify(certificate, [])
        except verification.VerificationError as error:
            words = "OPC UA server: a client is refused, as its certificate is not trusted"
            advice = "if it is in opcua.trusted_folder, check the clock of this machine, and restart the service"
            self._repeated.failed(f"{words}: {error}; {advice}")
            return False
        return True


def _require_issuer(_policy: verification.Policy, _issuer: Certificate, constraints: BasicConstraints | None) -> None:
    if not (constraints and constraints.ca):
        raise ValueError("the issuer's certificate is none of an authority (basicConstraints)")


class Clients(UserManager):  # type: ignore[misc]  # mypy skips the types of the library
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
        if self._trusted and not (certificate and self._trusted.is_trusted(load_der_x509_certificate(certificate))):
            raise ServiceError(ua.StatusCodes.BadCertificateUntrusted)
        given, held = f"{username or ''}\n{password or ''}", f"{self._name}\n{self._password}"
        if self._password is not None and not hmac.compare_digest(given.encode(), held.encode()):
            return None
        return User(role=UserRole.User)


@dataclass(frozen=True)
class Security:
    """The protection of the server, as read from its files."""

    clients: Clients
    has_password: bool
    has_trusted: bool
    """True if only clients with certain certificates may connect."""
    own: tuple[Certificate, RSAPrivateKey] | None
    """Certificate and key; without them, connections are not encrypted."""

    def require_for_others(self, address: str) -> None:
        """Raise InputError unless an address beyond loopback has a certificate and a user."""
        needed = {
            "certificate_file and key_file": self.own is not None,
            "username and password_file": self.has_password,
        }
        missing = [keys for keys, is_there in needed.items() if not is_there]
        if missing:
            message = (
                f"[opcua]: {address} is open to the network, which requires a certificate and a user: "
                f"add {' and '.join(missing)}, or use 127.0.0.1"
            )
            raise InputError(message)

    async def apply(self, server: Server, door: Door) -> None:
        """Let a server that does not listen yet ask for the user and the certificates, and then the door."""
        server.set_identity_tokens([ua.UserNameIdentityToken if self.has_password else ua.AnonymousIdentityToken])
        policies = _ENCRYPTED if self.own else [ua.SecurityPolicyType.NoSecurity]
        server.set_security_policy(policies, permission_ruleset=door)
        if self.own:
            certificate, key = self.own
            await server.load_certificate(certificate.public_bytes(Encoding.DER), "der")
            content = key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
            await server.load_private_key(content, format="der")


def read_security(section: OpcUaSection) -> Security:
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
    if section.certificate_file and section.key_file:
        own = (_read_certificate(section.certificate_file), _read_key(section.key_file))
        if own[0].public_key() != own[1].public_key():
            raise InputError(f"{section.key_file}: not the key of {section.certificate_file}; correct [opcua]")
    trusted = _read_trusted(section.trusted_folder) if section.trusted_folder else None
    clients = Clients(section.username, password, trusted, are_encrypted=own is not None)
    return Security(clients, password is not None, trusted is not None, own)


def _read_trusted(folder: Path) -> TrustedCertificates:
    paths = sorted(folder.glob("*")) if folder.is_dir() else []
    if not paths:
        message = (
            f"{folder}: no certificates of clients in it; set opcua.trusted_folder to a folder of PEM or DER files"
        )
        raise FailedError(message)  # they may come yet: a folder is empty until it is mounted
    return TrustedCertificates([_read_certificate(path) for path in paths])


def _read_certificate(path: Path) -> Certificate:
    content = _read(path)
    try:
        return load_pem_x509_certificate(content) if _is_pem(content) else load_der_x509_certificate(content)
    except ValueError as error:
        raise InputError(f"{path}: not a PEM or DER certificate ({error}); correct [opcua]") from None


def _read_key(path: Path) -> RSAPrivateKey:
    content = _read(path)
    try:
        key = load_pem_private_key(content, None) if _is_pem(content) else load_der_private_key(content, None)
    except (ValueError, TypeError) as error:
        message = f"{path}: not a PEM or DER private key without a passphrase ({error}); correct [opcua]"
        raise InputError(message) from None
    if not isinstance(key, RSAPrivateKey):
        raise InputError(f"{path}: not an RSA key, which the security policies of OPC UA need; correct [opcua]")
    return key


def _read(path: Path) -> bytes:
    try:
        return read_bounded(path)
    except OSError as error:
        raise FailedError(f"{path}: {error.strerror}") from None


def _is_pem(content: bytes) -> bool:
    return b"-----BEGIN" in content
