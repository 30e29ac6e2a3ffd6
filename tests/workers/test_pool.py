"""Cores and the actors on them: one busy actor per core, and warm ones first."""

import time

import pytest
import ray

from tests.workers.marks import RAY
from workers.cluster import RayOptions
from workers.pool import Actor, Core, Pool

pytestmark = RAY


@pytest.fixture
def run_id(request):
    """An id of each test's own, because Ray frees the name of a dead actor late."""
    return f"run_{request.node.name}"


@pytest.fixture
def pool(cluster):
    """A pool of two cores; its processes end with the cluster."""
    return Pool(RayOptions())


def test_a_core_is_warm_for_a_role_if_one_of_its_actors_can_compute_it():
    core = Core("node")
    assert core.warm("trainer") is None
    core.actors["inference"] = inference = Actor("inference", "inference", None, core)
    assert core.warm("inference") is core.warm("target") is inference
    assert core.warm("trainer") is None


def test_a_visit_prefers_an_inference_actor_and_takes_a_trainer():
    core = Core("node")
    core.actors["trainer"] = trainer = Actor("trainer", "trainer", None, core)
    assert core.warm("target") is trainer
    core.actors["inference"] = inference = Actor("inference", "inference", None, core)
    assert core.warm("target") is inference


def test_there_are_as_many_actors_at_work_as_cores(pool, run_id):
    assert (len(pool), pool.is_at_home) == (2, True)
    first, second = (pool.take("trainer", run_id, None) for _ in range(2))
    assert first.core is not second.core
    assert pool.take("target", "run_b", None) is None
    pool.give_back(first)
    assert pool.take("trainer", "run_b", None) is first


def test_a_later_service_does_not_ask_for_the_names_of_an_earlier_one(pool, run_id):
    """Ray keeps them until it has noticed that their node is dead."""
    names = [pool.take("trainer", run_id, None).name]
    names.append(Pool(RayOptions()).take("trainer", run_id, None).name)
    assert len(set(names)) == 2


def test_no_more_cores_are_at_work_than_allowed(cluster, run_id):
    pool = Pool(RayOptions(max_cores=1))
    only = pool.take("trainer", run_id, None)
    assert pool.take("trainer", run_id, None) is None
    pool.give_back(only)
    assert pool.take("inference", run_id, None)


def test_only_nodes_with_the_resource_have_cores_for_us(cluster):
    assert len(Pool(RayOptions(resource="adr_trainer"))) == 0


def test_an_actor_is_named_after_its_first_run_and_its_role(pool, run_id):
    actor = pool.take("target", run_id, None)
    assert actor.name.startswith(f"adr:{run_id}:inference:")
    pool.give_back(actor)
    assert pool.take("inference", "run_b", None) is actor


def test_after_a_loss_another_actor_of_another_name_is_started(pool, run_id):
    lost = pool.take("trainer", run_id, None)
    pool.lose(lost)
    following = pool.take("trainer", run_id, None)
    assert following.name != lost.name


def test_a_new_actor_is_started_in_the_place_of_a_warm_one_that_may_have_died(pool, run_id):
    """Three dead ones in a row failed the stage, though no process had begun it."""
    old, kept = (pool.take("trainer", run_id, None) for _ in range(2))
    pool.give_back(old)
    lost_at = time.monotonic()
    new = pool.take("trainer", run_id, None, newer_than=lost_at)
    assert (new.core, new.core.actors) == (old.core, {"trainer": new})
    with pytest.raises(ray.exceptions.RayActorError):
        ray.get(old.handle.__ray_ready__.remote())
    pool.give_back(kept)
    pool.give_back(new)
    assert pool.take("trainer", run_id, None, newer_than=lost_at) is new


def test_after_a_loss_an_empty_core_is_taken_before_one_with_an_old_actor(pool, run_id):
    old = pool.take("inference", run_id, None)
    pool.give_back(old)
    new = pool.take("inference", run_id, None, newer_than=time.monotonic())
    assert new.core is not old.core
    assert old.core.actors == {"inference": old}


def test_the_only_node_is_taken_though_it_should_be_avoided(pool, run_id):
    """The stage would wait for ever."""
    node = pool.take("trainer", run_id, None).core.node
    assert pool.take("trainer", run_id, avoid=node).core.node == node


def test_idle_actors_end_and_busy_ones_stay(cluster, run_id):
    pool = Pool(RayOptions(keep_idle_s=0.0))
    idle, busy = (pool.take("trainer", run_id, None) for _ in range(2))
    pool.give_back(idle)
    pool.refresh()
    assert idle.core.actors == {}
    assert busy.core.actors == {"trainer": busy}
    with pytest.raises(ray.exceptions.RayActorError):
        ray.get(idle.handle.__ray_ready__.remote())


def warm(node):
    core = Core(node)
    core.actors["trainer"] = Actor(node, "trainer", None, core)
    return core


def test_a_node_at_work_is_preferred_and_the_one_that_lost_the_stage_is_avoided(pool):
    """So the others become idle and can be released, and a sick node does not get it again."""
    pool._cores = [warm("small"), warm("large"), warm("large")]
    first = pool.take("trainer", "run_a", avoid="small")
    assert first.core.node == "large"
    second = pool.take("trainer", "run_a", avoid=None)
    assert second.core.node == "large"
    assert pool.take("trainer", "run_a", avoid="small") is None
    assert pool.take("trainer", "run_a", avoid=None).core.node == "small"


def test_a_node_without_others_is_not_avoided(pool):
    pool._cores = [warm("only")]
    assert pool.take("trainer", "run_a", avoid="only").core.node == "only"
