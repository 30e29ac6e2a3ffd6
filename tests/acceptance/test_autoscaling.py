"""Ray's autoscaler adds the nodes that work needs, and removes them when there is none."""

import pytest

from tests.heads import RESOURCE, start_head
from tests.service import start_service, until, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]
TRAINING = {"max_steps": 3000, "evaluate_every": 3000}
BENCHMARK = {"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"}


def test_from_no_node_a_benchmark_runs_and_nodes_go_away_again(tmp_path, secret):
    with start_head(secret, nodes=2) as head:
        settings = {
            "ADR_RAY_ADDRESS": head.address,
            "ADR_MAX_CORES": "2",
            "ADR_RESOURCE": RESOURCE,
            "ADR_KEEP_IDLE_S": "2",
        }
        with start_service(tmp_path, cpus=None, environment={**secret, **settings}) as service:
            client = service.client
            assert (client.ready()["cores"], len(head.running("raylet"))) == (0, 1)
            id = client.submit_benchmark({**BENCHMARK, "training": TRAINING})["id"]
            until(lambda: client.ready()["cores"] == 2)
            assert wait_until_finished(client, id, 600)["states"] == {"succeeded": 3}
            until(lambda: client.ready()["cores"] == 0)
            until(lambda: len(head.running("raylet")) == 1)
        assert "asked the autoscaler for 2 cores" in service.log.read_text()
