"""The files for Kubernetes and Slurm, as far as they can be checked without either."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import helm_python
import pytest
import yaml

from api.settings import Settings
from tests.test_project import ROOT

CHART = ROOT / "docs/deploy/kuberay"
SLURM = ROOT / "docs/deploy/slurm"
TOKENS = {"tokens": {name: name.ljust(16, "x") for name in ("api", "ray", "postgresql")}}


def rendered(values):
    """The objects of Kubernetes that Helm makes of the chart, by kind and name."""
    files = helm_python.Chart.load(str(CHART)).render(values, name="adr")
    objects = [each for text in files.values() for each in yaml.safe_load_all(text) if each]
    return {(each["kind"], each["metadata"]["name"]): each for each in objects}


def containers(cluster):
    spec = cluster["spec"]
    groups = [spec["headGroupSpec"], *spec["workerGroupSpecs"]]
    return [each for group in groups for each in group["template"]["spec"]["containers"]]


class TestChart:
    def test_helm_finds_no_fault(self):
        found = helm_python.lint(str(CHART), TOKENS)
        assert found["errors"] == []

    def test_all_objects_are_made(self):
        assert set(rendered(TOKENS)) == {
            ("Secret", "adr"),
            ("RayCluster", "adr"),
            ("Service", "adr"),
            ("PersistentVolumeClaim", "adr-data"),
            ("Service", "adr-postgresql"),
            ("StatefulSet", "adr-postgresql"),
        }

    def test_a_secret_and_a_database_of_your_own_take_the_place_of_the_charts(self):
        own = {"secret": "mine", "postgresql": {"enabled": False}}
        objects = rendered(own)
        assert {kind for kind, _ in objects} == {"RayCluster", "Service", "PersistentVolumeClaim"}
        assert objects["RayCluster", "adr"]["spec"]["authOptions"]["secretName"] == "mine"

    def test_every_node_needs_the_token_and_has_the_same_image(self):
        cluster = rendered({**TOKENS, "image": "registry/adr:1"})["RayCluster", "adr"]
        assert cluster["spec"]["authOptions"] == {"mode": "token", "secretName": "adr"}
        assert {each["image"] for each in containers(cluster)} == {"registry/adr:1"}
        assert "ray==" + cluster["spec"]["rayVersion"] in (ROOT / "constraints.txt").read_text()

    def test_nodes_for_stages_are_as_many_as_the_cores_need_and_none_at_first(self):
        given = {**TOKENS, "cores": 33, "worker": {"cores": 16, "memory": "8Gi"}}
        trainers, api = rendered(given)["RayCluster", "adr"]["spec"]["workerGroupSpecs"]
        assert [trainers[name] for name in ("replicas", "minReplicas", "maxReplicas")] == [0, 0, 3]
        assert [api[name] for name in ("minReplicas", "maxReplicas")] == [1, 1]
        # as the shell reads it that starts the node
        (resources,) = shlex.split(trainers["rayStartParams"]["resources"])
        assert json.loads(resources) == {"adr_trainer": 16}
        assert trainers["rayStartParams"]["num-cpus"] == "16"

    def test_the_service_has_settings_that_it_knows(self):
        cluster = rendered({**TOKENS, "api": {"settings": {"ADR_RETENTION_DAYS": "30"}}})
        (api,) = [each for each in containers(cluster["RayCluster", "adr"]) if "env" in each]
        given = {
            each["name"]: each.get("value", each["name"].ljust(16, "x")) for each in api["env"]
        }
        names = {name.removeprefix("ADR_").lower() for name in given}
        assert names <= set(Settings.model_fields)
        read = Settings.model_validate({name[4:].lower(): value for name, value in given.items()})
        assert (read.max_cores, read.resource, read.retention_days) == (200, "adr_trainer", 30)

    def test_the_service_has_no_variables_of_kubernetes_and_a_folder_of_its_own(self):
        *_, api = rendered(TOKENS)["RayCluster", "adr"]["spec"]["workerGroupSpecs"]
        assert api["template"]["spec"]["enableServiceLinks"] is False
        (container,) = api["template"]["spec"]["containers"]
        folder = {each["name"]: each.get("value") for each in container["env"]}["ADR_DATA_DIR"]
        volume = {each["name"]: each["mountPath"] for each in container["volumeMounts"]}["data"]
        assert Path(folder).parent == Path(volume)

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({}, "set tokens.postgresql, or name a Secret"),
            ({**TOKENS, "tokens": {"api": "short"}}, "/tokens/api"),
            ({**TOKENS, "cores": 0}, "/cores"),
            ({**TOKENS, "coers": 8}, "coers"),
            (
                {**TOKENS, "api": {"settings": {"ADR_ROBOT_TOKEN": "in the clear"}}},
                "ADR_ROBOT_TOKEN",
            ),
            ({**TOKENS, "postgresql": {"enabled": False}}, "name a Secret in secret"),
            ({**TOKENS, "worker": {"cores": 4, "memory": "32"}}, "/worker/memory"),
        ],
        ids=str,
    )
    def test_wrong_values_are_refused_by_name(self, given, message):
        with pytest.raises(helm_python.HelmError, match=message):
            rendered(given)


@pytest.mark.parametrize("name", ["adr.sbatch", "benchmark.sh"])
def test_shellcheck_finds_no_fault(name):
    shellcheck = Path(sys.executable).parent / "shellcheck"
    command = [shellcheck, "--shell=bash", SLURM / name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
