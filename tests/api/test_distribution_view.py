"""The file of `adr results --distribution`, and the environments that it fits."""

import gymnasium
import pytest

from adr_service.errors import InvalidInput
from api.cli.films import Scene, film_beside_target
from api.routes.run_results import distribution_view
from tests.benchmark.test_claims import FRICTION, outcome


def file_of(**given):
    return distribution_view(outcome(1.0, **given)).model_dump(mode="json")


@pytest.mark.parametrize(
    ("method", "environment"),
    [("simopt", "adr/RandomHopperUnmodeled-v0"), ("oracle", "adr/RandomHopper-v0")],
)
def test_a_distribution_fits_the_environment_of_its_own_parameters(method, environment):
    """The oracle trains in the target's own space, also where the run's variant lacks a mass."""
    file = file_of(method=method, variant="unmodeled")
    env = gymnasium.make(environment, distribution=file).unwrapped
    env.reset(seed=0)
    assert list(env.dynamics) == [parameter["name"] for parameter in file["parameters"]]


def test_a_distribution_beside_effects_is_not_simulated_without_them(tmp_path):
    file = file_of(extension=[FRICTION])
    with pytest.raises(InvalidInput, match=r"joint_viscous_friction.*this environment lacks"):
        gymnasium.make("adr/RandomHopper-v0", distribution=file)
    path = tmp_path / "distribution.json"
    path.write_text(distribution_view(outcome(1.0, extension=[FRICTION])).model_dump_json())
    scene = Scene("hopper", "vanilla", {}, None, 0)
    with pytest.raises(InvalidInput, match="has effects beyond it"):
        film_beside_target(scene, tmp_path / "policy.npz", path, tmp_path / "film.gif")
