"""The API as its own description tells it: complete, versioned, and held to by the service."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from api.app import create_app
from api.settings import Settings
from tests.service import start_service

GOLDEN = Path(__file__).parent / "openapi.json"
# validity hangs on what is stored, and on how fields go together: no JSON schema says that
CONFIG = """
[checks]
positive_data_acceptance.expected-statuses = ["2xx", 401, 403, 404, 409, 422, 429, 503, 507]
# too many members make too large a body
negative_data_rejection.expected-statuses = ["4xx", "5xx"]

# a run has a distribution and a policy after its first iteration
[[operations]]
include-name = "GET /v1/runs/{run_id}/distribution"
checks.ensure_resource_availability.enabled = false

[[operations]]
include-name = "GET /v1/runs/{run_id}/policy"
checks.ensure_resource_availability.enabled = false
"""


@pytest.fixture(scope="module")
def described():
    return create_app(Settings()).openapi()


def test_the_description_is_the_golden_file(described):
    """A change of the API is a change of this file; ADR_WRITE_GOLDEN=1 writes it anew."""
    text = json.dumps(described, indent=1, sort_keys=True) + "\n"
    if os.environ.get("ADR_WRITE_GOLDEN"):
        GOLDEN.write_text(text)
    assert text == GOLDEN.read_text(), "run with ADR_WRITE_GOLDEN=1, and read the difference"


def test_every_route_has_a_description_and_a_problem(described):
    for path, methods in described["paths"].items():
        for method, route in methods.items():
            assert route.get("description"), f"{method} {path} has no description"
            refused = route["responses"]["default"]["content"]
            assert list(refused) == ["application/problem+json"]


def test_every_parameter_has_a_description(described):
    for path, methods in described["paths"].items():
        for method, route in methods.items():
            for parameter in route.get("parameters", []):
                assert parameter.get("description"), f"{method} {path}: {parameter['name']}"


@pytest.mark.ray
@pytest.mark.parametrize(
    ("phases", "examples", "least"),
    [
        ("examples,fuzzing", 2, 100),
        pytest.param("examples,coverage,fuzzing,stateful", 40, 2000, marks=pytest.mark.slow),
    ],
)
def test_schemathesis_finds_nothing(tmp_path, phases, examples, least):
    (tmp_path / "schemathesis.toml").write_text(CONFIG)
    settings = {"ADR_MAX_LIVE_RUNS": "20", "ADR_LEASE_S": "5", "ADR_RATE": "5000/second"}
    with start_service(tmp_path, cpus=1, environment=settings) as running:
        command = [Path(sys.executable).parent / "st"]
        command += ["--config-file", tmp_path / "schemathesis.toml", "run"]
        command += [
            f"{running.client.url}/openapi.json",
            "--seed",
            "1",
            "--no-color",
            "--phases",
            phases,
        ]
        command += ["--max-examples", str(examples), "--request-timeout", "60"]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
        assert ended.returncode == 0, ended.stdout[-20_000:]
        generated = re.search(r"(\d+) generated", ended.stdout)
        assert generated is not None
        assert int(generated[1]) > least
        log = running.log.read_text()
    assert "Traceback" not in log
    assert " 500 " not in log
