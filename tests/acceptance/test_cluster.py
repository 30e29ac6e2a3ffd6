"""A cluster of three nodes, one of which dies: the same bytes as on one node."""

import os
import subprocess
import sys

import pytest

from adr_service.client import Refused
from tests.acceptance.test_faults import committed
from tests.acceptance.test_kills import BENCHMARK, WORK, undisturbed, working
from tests.heads import start_head
from tests.service import start_service, until, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]


@pytest.fixture
def nodes(secret):
    """A head, which adds and removes workers when told; see `tests.nodes`."""
    environment = {**os.environ, **secret}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    command = [sys.executable, "-m", "tests.nodes"]
    with subprocess.Popen(command, env=environment, text=True, **pipes) as process:
        yield process
        process.stdin.close()
        process.wait(60)


def told(process, word):
    """The rest of the next line that begins with a word; Ray prints others."""
    for line in process.stdout:
        if line.startswith(word):
            return line.removeprefix(word).strip()
    raise RuntimeError("the nodes have ended")


def tell(process, line):
    process.stdin.write(f"{line}\n")
    process.stdin.flush()
    told(process, "done")


def test_a_node_that_dies_in_the_middle_changes_nothing(tmp_path_factory, nodes, secret):
    table, stages = undisturbed(tmp_path_factory.mktemp("one"))
    folder = tmp_path_factory.mktemp("three")
    environment = {**secret, "ADR_RAY_ADDRESS": told(nodes, "address")}
    with start_service(folder, cpus=None, environment=environment) as service:
        with pytest.raises(Refused, match="no node of the cluster has any CPU"):
            service.client.submit_benchmark(BENCHMARK)
        tell(nodes, "add")
        tell(nodes, "add")
        until(lambda: service.client.ready()["cores"] == 2)
        id = service.client.submit_benchmark(BENCHMARK)["id"]
        until(lambda: working(service.client, id, WORK["trainer"]))
        before = committed(folder)
        tell(nodes, "remove")
        final = wait_until_finished(service.client, id, 600)
        assert final["states"] == {"succeeded": 4}
        assert service.client.results_csv(id) == table
        attempts = service.attempts
        assert service.client.ready()["cores"] == 1
    lost = len(stages - committed(folder))
    twice = sum(digest in before for digest, number in attempts if number > 1)
    sys.stderr.write(f"node removed: runs completed 4, lost {lost}, committed twice {twice}\n")
    assert (lost, twice) == (0, 0)
    assert {number for _, number in attempts} == {1, 2}


def test_the_head_of_a_joined_cluster_is_waited_for(tmp_path, secret):
    with start_head(secret, cores=1) as head:
        environment = {**secret, "ADR_RAY_ADDRESS": head.address}
        with start_service(tmp_path, cpus=None, environment=environment) as service:
            id = service.client.submit_benchmark(BENCHMARK)["id"]
            until(lambda: working(service.client, id, WORK["trainer"]))
            before = committed(tmp_path)
            (gcs,) = head.running("gcs_server")
            gcs.kill()
            head.process.wait(60)
            until(lambda: "waiting until its head answers again" in service.log.read_text())
            with start_head(secret, cores=1, port=head.port):
                final = wait_until_finished(service.client, id, 600)
                assert final["states"] == {"succeeded": 4}
            attempts = service.attempts
    assert {number for _, number in attempts} == {1, 2}
    assert not [digest for digest, number in attempts if number > 1 and digest in before]
