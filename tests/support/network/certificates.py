"""Certificates of a test's own, made by openssl."""

import subprocess
from collections.abc import Sequence
from pathlib import Path

from support.running.debian_parts import require

ELLIPTIC = ("ec", "-pkeyopt", "ec_paramgen_curve:prime256v1")


def make_certificate(
    folder: Path,
    name: str = "IP:127.0.0.1",
    key_kind: Sequence[str] = ELLIPTIC,
    more: Sequence[str] = (),
    *,
    is_expired: bool = False,
) -> tuple[Path, Path]:
    """Write a certificate for a name that signs itself, and its key; returns both."""
    openssl = require("openssl", "openssl")
    earlier = [require("faketime", "faketime"), "-f", "-10d"] if is_expired else []
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    kind = ("-x509", "-newkey", *key_kind, "-nodes", "-days", "2")
    subject = ("-subj", "/CN=localhost", "-addext", f"subjectAltName={name}", *more)
    files = ("-keyout", str(key), "-out", str(certificate))
    subprocess.run([*earlier, openssl, "req", *kind, *subject, *files], check=True, capture_output=True)
    return certificate, key
