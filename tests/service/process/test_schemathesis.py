"""What the service is against what its OpenAPI document says, by a tool that knows only that document."""

import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import Service

CHECKS_NOT_HELD = "not_a_server_error,positive_data_acceptance"
"""503 is an answer of its own kind here, and a batch has rules between its members that a schema cannot state."""


@pytest.mark.promise(
    "docs/reference/http.md",
    "`/openapi.json` describes every route with its parameters, examples and tokens.",
)
@pytest.mark.soak
@pytest.mark.long
@pytest.mark.timeout(600)
def test_no_answer_departs_from_the_document(fresh: Service, tmp_path: Path) -> None:
    service = fresh
    program = Path(sys.executable).with_name("schemathesis")
    command = [
        *(str(program), "run", f"{service.url}/openapi.json", "--header", f"Authorization: Bearer {service.token}"),
        *("--checks", "all", "--exclude-checks", CHECKS_NOT_HELD, "--exclude-path-regex", "stream$"),
        *("--max-examples", "20", "--seed", "1", "--request-timeout", "30", "--no-color"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=550, cwd=tmp_path)
    assert done.returncode == 0, done.stdout[-5000:]
    metrics = service.get("/metrics").text
    assert 'kind="internal"' not in metrics
    assert service.get("/health/live").is_success
