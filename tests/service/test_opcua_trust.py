"""The clients that an OPC UA server with `trusted_folder` takes: those of the folder, and whom they vouch for."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, generate_private_key
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from beamtouch_service.outputs.opcua.section import OpcUaSection
from beamtouch_service.outputs.opcua.security import TrustedCertificates, read_security

Keyed = tuple[x509.Certificate, RSAPrivateKey]


def certificate_of(name: str, issuer: Keyed | None = None, *, is_authority: bool = False) -> Keyed:
    """Return a certificate with its key, signed by an issuer or by itself."""
    key, now = generate_private_key(65537, 2048), datetime.now(UTC)
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    vouching = issuer[1] if issuer else key
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer[0].subject if issuer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(f"urn:{name}")]), critical=False)
        .add_extension(x509.BasicConstraints(ca=is_authority, path_length=None), critical=True)
        .sign(vouching, SHA256())
    )
    return made, key


@pytest.mark.promise("docs/how-to/opcua.md", "with it, only one whose certificate, or that of its issuer, lies there.")
def test_a_client_is_trusted_by_its_own_certificate_or_that_of_its_issuer_and_by_no_other() -> None:
    authority, other = (certificate_of(name, is_authority=True) for name in ("plant", "elsewhere"))
    (own, _), (issued, _), (foreign, _) = (
        certificate_of("client"),
        certificate_of("issued", authority),
        certificate_of("foreign", other),
    )
    trusted = TrustedCertificates([own, authority[0]])
    assert [trusted.is_trusted(one) for one in (own, issued, foreign, certificate_of("plant")[0])] == [
        *(True, True, False, False)
    ]


@pytest.mark.promise("docs/how-to/opcua.md", "Files may be PEM or DER, whatever their names.")
@pytest.mark.parametrize("encoding", [Encoding.PEM, Encoding.DER])
def test_what_a_file_is_is_said_by_its_content(tmp_path: Path, encoding: Encoding) -> None:
    certificate, key = certificate_of("server")
    (tmp_path / "one").write_bytes(certificate.public_bytes(encoding))
    (tmp_path / "two").write_bytes(key.private_bytes(encoding, PrivateFormat.PKCS8, NoEncryption()))
    (tmp_path / "clients").mkdir()
    (tmp_path / "clients" / "any").write_bytes(certificate.public_bytes(encoding))
    keys = {"certificate_file": tmp_path / "one", "key_file": tmp_path / "two", "trusted_folder": tmp_path / "clients"}
    security = read_security(OpcUaSection.model_validate(keys))
    assert security.own is not None
    assert security.own[0] == certificate
    assert security.own[1].private_numbers() == key.private_numbers()
    assert (security.has_password, security.has_trusted) == (False, True)
