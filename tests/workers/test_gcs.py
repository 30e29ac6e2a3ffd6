"""A GCS that dies: ours is started again under running stages, another's is waited for."""

import socket

import psutil
import pytest
import ray

from tests.service import free_port, until
from tests.workers.marks import RAY
from workers import gcs
from workers.cluster import Cluster, ClusterUnavailable, RayOptions
from workers.gcs import OwnGcs, child

pytestmark = RAY


def start_counter(**options):
    """Start an actor that has a state to lose; its process knows nothing of this module."""

    class Counter:
        def __init__(self):
            self.count = 0

        def add(self):
            self.count += 1
            return self.count

    return ray.remote(Counter).options(num_cpus=0.5, **options).remote()


def test_actors_go_on_under_a_gcs_that_was_killed(cluster):
    counter = start_counter()
    assert ray.get(counter.add.remote()) == 1
    killed = child("gcs_server")
    killed.kill()
    until(lambda: child("gcs_server") not in (None, killed))
    another = start_counter(name="another")
    assert ray.get([counter.add.remote(), another.add.remote()]) == [2, 1]
    assert [node["Alive"] for node in ray.nodes()] == [True]
    assert cluster.is_alive
    for actor in (counter, another):
        ray.kill(actor)


@pytest.mark.slow
def test_a_gcs_that_was_started_again_ends_with_the_cluster(cluster):
    killed = child("gcs_server")
    killed.kill()
    following = until(lambda: (found := child("gcs_server")) != killed and found)
    cluster.restart()
    assert not psutil.pid_exists(following.pid)
    assert ray.nodes()


def test_a_watch_over_the_gcs_that_fails_says_so_and_lets_the_cluster_end(tmp_path, monkeypatch):
    def fail():
        raise OSError("no memory")

    monkeypatch.setattr(gcs, "_found", fail)
    watched = OwnGcs(tmp_path)
    watched.start()
    until(lambda: not watched.is_alive)
    watched.leave_alone()
    watched.end()


def test_a_head_that_answers_is_not_asked_before_we_have_joined():
    with socket.create_server(("127.0.0.1", 0)) as head:
        assert not Cluster(RayOptions(address=f"127.0.0.1:{head.getsockname()[1]}")).is_alive


def test_joining_where_no_cluster_answers_says_so_at_once():
    address = f"127.0.0.1:{free_port()}"
    with pytest.raises(ClusterUnavailable, match=f"no Ray cluster answers at {address}"):
        Cluster(RayOptions(address=address)).start()
