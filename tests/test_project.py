"""The files around the code: what they promise is checked by reading them."""

import ast
import importlib.metadata
import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest
import yaml

from api.settings import Settings
from tests.packages import build_wheel, committed

ROOT = Path(__file__).parent.parent
PACKAGES = ("adr_service", "workers", "db", "api")
# of FastAPI, pydantic, uvicorn and sbx-rl, and pinned by them
PARTS = {"starlette", "anyio", "pydantic-core", "h11", "jax", "flax", "optax"}

NODES = ("head", "worker", "api")


@pytest.fixture(scope="module")
def compose():
    return yaml.safe_load((ROOT / "docker-compose.yml").read_text())


@pytest.fixture(scope="module")
def nodes(compose):
    """The services that compute, without those that watch."""
    return {name: compose["services"][name] for name in NODES}


class TestCompose:
    def test_one_image_serves_head_workers_and_api(self, nodes):
        assert len({service["image"] for service in nodes.values()}) == 1
        assert [name for name, service in nodes.items() if "build" in service] == ["head"]

    def test_only_this_machine_reaches_the_api_and_the_dashboards(self, compose):
        ports = {name: service.get("ports", []) for name, service in compose["services"].items()}
        assert ports == {
            "head": ["127.0.0.1:8265:8265"],
            "worker": [],
            "api": ["127.0.0.1:8000:8000"],
            "prometheus": [],
            "grafana": ["127.0.0.1:3000:3000"],
        }
        assert compose["networks"]["cluster"]["internal"] is True

    def test_every_node_needs_the_clusters_token(self, compose, nodes):
        for service in nodes.values():
            assert service["environment"]["RAY_AUTH_MODE"] == "token"
            assert ":?" in service["environment"]["RAY_AUTH_TOKEN"]
        assert ":?" in compose["services"]["api"]["environment"]["ADR_TOKEN"]

    def test_every_node_has_room_for_objects_and_a_health_check(self, nodes):
        for service in nodes.values():
            assert service["shm_size"] == "1gb"
            assert service["healthcheck"]["test"][0] == "CMD"

    def test_no_service_logs_without_end(self, compose):
        for service in compose["services"].values():
            assert service["logging"]["driver"] == "json-file"
            assert {"max-size", "max-file"} <= set(service["logging"]["options"])

    def test_workers_can_be_scaled(self, compose):
        worker = compose["services"]["worker"]
        assert "container_name" not in worker
        assert not worker.get("ports")

    def test_nodes_meet_on_the_network_that_all_of_them_reach(self, compose, nodes):
        """Docker gives the address of a name on a network without `internal` first."""
        alias = "ray-head"
        assert nodes["head"]["networks"]["cluster"]["aliases"] == [alias]
        assert not nodes["head"]["networks"]["published"]
        text = (ROOT / "docker-compose.yml").read_text()
        assert set(re.findall(r"[\w-]+:6379", text)) == {f"{alias}:6379", "localhost:6379"}

    def test_workers_on_one_machine_can_share_its_cores(self, nodes):
        asked = "${ADR_WORKER_CPUS:+--num-cpus=$ADR_WORKER_CPUS}"  # else all, as Ray counts them
        assert asked in nodes["worker"]["command"]

    def test_the_api_takes_every_setting_that_is_for_such_a_cluster(self, compose):
        """A name alone takes the shell's value, and sets nothing where there is none."""
        given = compose["services"]["api"]["environment"]
        # of the place where it listens, of a Ray of its own, and of clusters of other nodes
        others = {"host", "port", "cpus", "dashboard", "max_cores", "resource"}
        names = {name.removeprefix("ADR_").lower() for name in given if name.startswith("ADR_")}
        assert names == set(Settings.model_fields) - others
        fixed = {"token", "ray_address", "ray_dashboard_url", "data_dir", "log_format"}
        fixed.add("allowed_hosts")  # where it has names, Prometheus' own is one of them
        assert given["ADR_ALLOWED_HOSTS"] == "${ADR_ALLOWED_HOSTS:+$ADR_ALLOWED_HOSTS,api}"
        assert {n for n in names if given[f"ADR_{n.upper()}"] is None} == names - fixed

    def test_results_live_in_a_volume_of_the_api_alone(self, compose):
        volumes = {name: s.get("volumes", []) for name, s in compose["services"].items()}
        mounted = [name for name, given in volumes.items() if "data:/data" in given]
        assert mounted == ["api"]

    def test_monitoring_is_a_profile_and_scrapes_every_node(self, compose):
        for name, service in compose["services"].items():
            assert service.get("profiles", []) == ([] if name in NODES else ["monitoring"])
        given = yaml.safe_load(compose["configs"]["prometheus"]["content"])
        service, ray = given["scrape_configs"]
        assert service["static_configs"] == [{"targets": ["api:8000"]}]
        (found,) = ray["dns_sd_configs"]
        assert set(found["names"]) == set(NODES)
        for name in NODES:
            command = compose["services"][name]["command"]
            assert f"--metrics-export-port={found['port']}" in command
        networks = [
            set(compose["services"][name]["networks"]) for name in ("prometheus", "grafana")
        ]
        assert "cluster" in set.intersection(*networks)
        source = yaml.safe_load(compose["configs"]["grafana-source"]["content"])["datasources"][0]
        dashboard = json.loads((ROOT / compose["configs"]["grafana-dashboard"]["file"]).read_text())
        assert {panel["datasource"]["uid"] for panel in dashboard["panels"]} == {source["uid"]}


def test_the_image_copies_every_package_and_the_pinned_versions():
    dockerfile = (ROOT / "Dockerfile").read_text()
    for package in ("adr_service", "workers", "db", "api"):
        assert f"COPY {package} {package}" in dockerfile
    assert dockerfile.count("--constraint constraints.txt") == 2


def test_every_dependency_is_pinned():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wanted = project["project"]["dependencies"] + project["dependency-groups"]["dev"]
    for extra in project["project"]["optional-dependencies"].values():
        wanted += extra
    names = {re.match(r"[\w-]+", line).group().lower().replace("_", "-") for line in wanted}
    pinned = {
        line.partition("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    assert names <= pinned, names - pinned


def test_every_library_that_is_imported_is_declared():
    """Only what we declare is sure to be there beside `pip install .`."""
    provided = importlib.metadata.packages_distributions()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    declared = {normal(re.match(r"[\w-]+", line).group()) for line in lines}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for name in imported(path) - set(PACKAGES) - set(sys.stdlib_module_names):
                ours = {normal(each) for each in provided.get(name, [name])}
                assert ours & (declared | PARTS), f"{name} in {path}"


def test_an_installed_service_has_its_pages_migrations_and_models(tmp_path):
    held = set(zipfile.ZipFile(build_wheel(tmp_path)).namelist())
    needed = {name for name in committed() if name.split("/")[0] in PACKAGES}
    assert needed - held == set()


def imported(path: Path) -> set[str]:
    """Top-level modules that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.partition(".")[0])
    return found


def normal(name: str) -> str:
    return name.lower().replace("_", "-")


def test_continuous_integration_runs_the_readmes_test_command():
    assert "make test" in (ROOT / "README.md").read_text()
    commands = (ROOT / ".ci/run").read_text().splitlines()
    assert commands[-1] == "make test"


@pytest.mark.parametrize(
    "target", ["setup", "demo", "serve", "test", "test-slow", "lint", "bench-sim", "bench-dropo"]
)
def test_every_make_target_knows_what_to_do(target):
    done = subprocess.run(
        ["make", "--dry-run", target],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": os.environ["PATH"]},
    )
    assert done.returncode == 0, done.stderr


def test_the_changelog_speaks_of_this_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"## {project['version']}" in (ROOT / "CHANGELOG.md").read_text()
