"""The registered Gymnasium environments."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import adr_service
from adr_service.distributions import Uniform
from adr_service.errors import InvalidInput, UnknownName
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import BUILT_IN, hidden_of, source_of
from tests.tasks.cases import CASES, IDS

assert adr_service.__version__  # importing it registers the names
ROBOTS = ("Arm", "Hopper", "HalfCheetah", "Walker2d", "Humanoid")


def id_of(task, variant):
    robot = dict(zip(BUILT_IN, ROBOTS, strict=True))[task]
    return f"adr/Random{robot}{'' if variant == 'vanilla' else variant.capitalize()}-v0"


@pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)
def test_gymnasiums_checker_complains_of_the_infinite_bounds_alone(task, variant):
    env = gymnasium.make(id_of(task.name, variant))
    assert env.spec.max_episode_steps == task.horizon
    with warnings.catch_warnings(record=True) as complaints:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)
    assert all("infinity" in str(complaint.message) for complaint in complaints)


@pytest.mark.parametrize("task", BUILT_IN)
def test_an_environment_simulates_the_same_as_the_training_environment(task):
    """The same generator gives the same dynamics, observations, rewards and endings."""
    source = source_of(task, "vanilla")
    belief = Uniform(source.space, source.space.low, source.space.high)
    one = gymnasium.make(id_of(task, "vanilla"), distribution=belief.to_json()).unwrapped
    observation, _ = one.reset(seed=3)
    generator, _ = gymnasium.utils.seeding.np_random(3)
    many = RandomizedVecEnv(BUILT_IN[task].task, source, belief, 1, generator)
    np.testing.assert_array_equal(observation.astype(np.float32), many.reset()[0])
    assert list(one.dynamics.values()) == many.dynamics[0].tolist()
    for action in np.random.default_rng(0).uniform(-0.3, 0.3, (10, *one.action_space.shape)):
        observation, reward, terminated, _, _ = one.step(action)
        seen, earned, done, infos = many.step(action[None])
        last = infos[0].get("terminal_observation", seen[0])
        np.testing.assert_array_equal(observation.astype(np.float32), last)
        assert (reward, terminated) == (earned[0], done[0])
        if terminated:
            break


def test_the_noisy_environment_has_noise_of_the_stated_variance():
    env = gymnasium.make("adr/RandomHopperNoisy-v0").unwrapped
    clean = gymnasium.make("adr/RandomHopper-v0").unwrapped
    errors = []
    for seed in range(300):
        errors.append(env.reset(seed=seed)[0] - clean.reset(seed=seed)[0])
    draws = np.array(errors)
    assert draws.std() == pytest.approx(np.sqrt(1e-4), rel=4 / np.sqrt(2 * draws.size))


def test_the_unmodeled_environment_has_fewer_parameters_and_true_ones():
    env = gymnasium.make("adr/RandomWalker2dUnmodeled-v0").unwrapped
    assert env.space.names == source_of("walker2d", "unmodeled").space.names
    hidden = hidden_of("walker2d", "unmodeled")
    truth = dict(zip(hidden.source.space.names, hidden.values.tolist(), strict=True))
    env.reset(seed=0)
    assert env.dynamics == {name: truth[name] for name in env.space.names}


def test_some_dynamics_can_be_given_at_reset():
    env = gymnasium.make("adr/RandomHopper-v0").unwrapped
    _, info = env.reset(options={"dynamics": {"torso_mass": 4.2}})
    assert info["dynamics"]["torso_mass"] == 4.2
    assert info["dynamics"]["leg_mass"] == hidden_of("hopper", "vanilla").values[2]


def test_a_diverged_simulation_ends_its_episode_with_a_flag_in_info():
    env = gymnasium.make("adr/RandomHopper-v0").unwrapped
    env.reset(seed=0)
    env._simulations.set_state(State(np.full((1, 6), np.nan), np.zeros((1, 6))))
    observation, reward, terminated, _, info = env.step(np.zeros(3))
    assert terminated
    assert info == {"diverged": True}
    assert reward == 0.0
    assert not observation.any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dynamics": {"torso": 3.0}}, "did you mean 'torso_mass'"),
        ({"dynamics": {"torso_mass": 0.0}}, "from 0.1 up; given 0.0"),
        ({"dynamics": {"torso_mass": np.nan}}, "from 0.1 up; given nan"),
        ({"dynamics": {"torso_mass": "heavy"}}, "from 0.1 up; given 'heavy'"),
        ({"dynamics": {"torso_mass": True}}, "from 0.1 up; given True"),
        ({"masses": {}}, "known: dynamics"),
        ({"dynamics": [3.0]}, "values by name"),
        ({"dynamics": {1: 3.0}}, "values by name; given the name 1"),
        ({"dynamics": {"torso_mass": 10**400}}, "a finite float from 0.1 up; given 1000"),
        ({1: 2, "masses": {}}, r"\[1, 'masses'\] are not known; known: dynamics"),
        ([3.0], r"options must be values by name; given \[3.0\]"),
    ],
)
def test_impossible_dynamics_are_refused_with_the_accepted_values(options, message):
    env = gymnasium.make("adr/RandomHopper-v0").unwrapped
    with pytest.raises((InvalidInput, UnknownName), match=message):
        env.reset(options=options)


def test_refused_dynamics_leave_the_episode_and_the_random_numbers_as_they_were():
    space = source_of("hopper", "vanilla").space
    belief = Uniform(space, space.low, space.high).to_json()
    env, other = (
        gymnasium.make("adr/RandomHopper-v0", distribution=belief).unwrapped for _ in range(2)
    )
    for each in (env, other):
        each.reset(seed=0)
    with pytest.raises(InvalidInput):
        env.reset(seed=1, options={"dynamics": {"torso_mass": 0.0}})
    np.testing.assert_array_equal(env.step(np.ones(3))[0], other.step(np.ones(3))[0])
    np.testing.assert_array_equal(env.reset()[0], other.reset()[0])
    assert env.dynamics == other.dynamics


def file_of(variant, count=1):
    """The file that `adr results --distribution` writes of a belief about Hopper."""
    space = source_of("hopper", variant).space
    belief = Uniform(space, space.low, space.high).to_json()
    return {"task": "hopper", "variant": variant, "distributions": [belief] * count}


def test_a_distribution_comes_from_its_file():
    from_file, alone = (
        gymnasium.make("adr/RandomHopper-v0", distribution=given).unwrapped
        for given in (file_of("noisy"), file_of("noisy")["distributions"][0])
    )
    for env in (from_file, alone):
        env.reset(seed=3)
    assert from_file.dynamics == alone.dynamics


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (file_of("edge"), "distribution is of hopper edge, whose parameters or search bounds"),
        (file_of("unmodeled"), "of hopper unmodeled, whose"),
        ({**file_of("vanilla"), "task": "walker2d"}, "is of walker2d vanilla"),
        ({**file_of("vanilla"), "variant": "windy"}, "there is no variant"),
        (file_of("vanilla", 2), "2 distributions are given; choose one"),
        ({**file_of("vanilla"), "extension": [{"kind": "wind"}]}, "which this environment lacks"),
        ({**file_of("vanilla"), "distributions": 3}, "must be a list of documents; given 3"),
        ({**file_of("vanilla"), "distributions": ["x"]}, "must be a list of documents"),
    ],
    ids=str,
)
def test_the_file_of_other_parameters_or_bounds_is_refused(file, message):
    """The same coordinates would be other masses."""
    with pytest.raises(InvalidInput, match=message):
        gymnasium.make("adr/RandomHopper-v0", distribution=file)


def test_a_reward_that_is_not_finite_is_refused():
    env = gymnasium.make("adr/RandomHopper-v0").unwrapped
    env.reset(seed=0)
    message = "the reward of hopper must be finite"
    with np.errstate(over="ignore"), pytest.raises(InvalidInput, match=message):
        env.step(np.array([1e200, 0.0, 0.0]))


@pytest.mark.parametrize("document", ["uniform", 3, ["uniform"]])
def test_a_distribution_that_is_no_document_is_refused(document):
    with pytest.raises(InvalidInput, match="must be the JSON document of one, or None; given"):
        gymnasium.make("adr/RandomHopper-v0", distribution=document)


@pytest.mark.parametrize(
    "action",
    [
        np.array([0.0, np.nan, 0.0]),  # MuJoCo would take it for zero
        np.zeros((1, 3)),
        np.zeros(2),
        None,
        "left",
        [0.0, [1.0], 0.0],
        [10**400, 0, 0],
    ],
    ids=str,
)
def test_an_action_that_is_not_finite_or_of_another_shape_is_refused_before_it_moves(action):
    env = gymnasium.make("adr/RandomHopper-v0").unwrapped
    env.reset(seed=0)
    before = env._simulations.state
    with pytest.raises(InvalidInput, match=r"must be finite, of shape \(3,\); given"):
        env.step(action)
    np.testing.assert_array_equal(env._simulations.state.qpos, before.qpos)


def test_a_frozen_parameter_cannot_be_set():
    env = gymnasium.make("adr/RandomHopperUnmodeled-v0").unwrapped
    with pytest.raises(InvalidInput, match="torso_mass is frozen"):
        env.reset(options={"dynamics": {"torso_mass": 4.0}})


def test_the_control_period_is_exact():
    assert gymnasium.make("adr/RandomHumanoid-v0").unwrapped.dt == pytest.approx(0.015, rel=1e-12)
