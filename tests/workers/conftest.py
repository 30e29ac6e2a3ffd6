"""A small cluster for the parts that need Ray and no dispatcher."""

import pytest

from workers.cluster import Cluster, RayOptions


@pytest.fixture(scope="session")
def ray_folder(tmp_path_factory):
    """One folder for all clusters of this process, because Ray keeps the first token."""
    return tmp_path_factory.mktemp("ray")


@pytest.fixture(scope="module")
def cluster(ray_folder):
    """Ray with two cores, on this machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        started = Cluster(
            RayOptions(cpus=2, dashboard=False, compile_cache=ray_folder / "jax", folder=ray_folder)
        )
        started.start()
        yield started
        started.close()
