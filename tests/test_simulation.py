import dataclasses
import importlib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adr_service.errors import InvalidInput, UnknownName
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.simulation.batch import Simulations, compiled
from adr_service.simulation.model import resolve
from adr_service.simulation.replay import Replay, check_recorded
from adr_service.simulation.rollout import follow, run_episodes
from adr_service.tasks.base import Source, State
from adr_service.tasks.catalogue import BUILT_IN, get_task, variants_of
from adr_service.transitions import TransitionDataset
from tests import recordings
from tests.plain import model_of
from tests.recordings import HOPPER_MASSES_KG

TASKS = [entry.task for entry in BUILT_IN.values()]
ROOT = Path(__file__).parent.parent
CASES = [(task, variant) for task in TASKS for variant in variants_of(task.name)]
IDS = [f"{task.name}-{variant}" for task, variant in CASES]


def recording(task, variant, steps=200):
    """Dynamics, initial state and actions of 5 simulations."""
    rng = np.random.default_rng(0)
    space = variants_of(task.name)[variant].source.space
    dynamics = rng.uniform(space.low, space.high, (5, len(space)))
    actions = rng.uniform(task.action_low, task.action_high, (steps, 5, len(task.action_low)))
    return dynamics, task.initial(5, rng), actions


def in_batch(task, variant, dynamics, initial, actions, threads=1):
    simulations = Simulations(task, variants_of(task.name)[variant].source, 5, threads=threads)
    simulations.set_dynamics(dynamics)
    simulations.set_state(initial)
    states = []
    for chosen in actions:
        simulations.step(chosen)
        states.append(np.concatenate(simulations.state, axis=1))  # also what is derived
    return np.array(states)


def one_by_one(task, variant, dynamics, initial, actions):
    """The same with plain MjData and a loop."""
    source, states = variants_of(task.name)[variant].source, []
    for i in range(5):
        model = model_of(task, source, dynamics[i])
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = initial.qpos[i], initial.qvel[i]
        rows = []
        for chosen in actions:
            data.ctrl[:] = chosen[i]
            for _ in range(task.frame_skip):
                mujoco.mj_step(model, data)
            derived = [getattr(data, name).ravel() for name in task.derived]
            rows.append(np.concatenate([data.qpos, data.qvel, *derived]))
        states.append(rows)
    return np.array(states).swapaxes(0, 1)


@pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)
def test_the_batch_equals_a_plain_loop_bit_for_bit(task, variant):
    case = (task, variant, *recording(task, variant))
    np.testing.assert_array_equal(in_batch(*case), one_by_one(*case))


@pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)
def test_the_number_of_threads_changes_nothing(task, variant):
    case = (task, variant, *recording(task, variant))
    np.testing.assert_array_equal(in_batch(*case), in_batch(*case, threads=3))


@pytest.mark.parametrize("task", TASKS, ids=[t.name for t in TASKS])
def test_a_diverged_simulation_is_nan_and_stays_so_and_the_others_are_unharmed(task):
    dynamics, initial, actions = recording(task, "vanilla", steps=20)
    qvel = initial.qvel.copy()
    qvel[2] = np.nan
    with_one_broken = in_batch(task, "vanilla", dynamics, State(initial.qpos, qvel), actions)
    whole = in_batch(task, "vanilla", dynamics, initial, actions)
    assert np.isnan(with_one_broken[-1, 2]).any()
    others = [0, 1, 3, 4]
    np.testing.assert_array_equal(with_one_broken[:, others], whole[:, others])


@pytest.mark.parametrize("task", TASKS, ids=[t.name for t in TASKS])
def test_a_simulation_that_explodes_has_diverged_though_it_is_finite(task):
    """MuJoCo's bound is 1e10."""
    dynamics, initial, _ = recording(task, "vanilla", steps=1)
    simulations = Simulations(task, variants_of(task.name)["vanilla"].source, 5)
    simulations.set_dynamics(dynamics)
    initial.qvel[2, -1] = 1e12
    simulations.set_state(initial)
    assert not simulations.diverged.any()
    simulations.step(np.zeros_like(task.action_low))
    assert simulations.diverged.tolist() == [False, False, True, False, False]
    observations = task.observe(simulations.state)
    assert np.isnan(observations[2, : task.measured]).any()
    others = np.delete(observations, 2, axis=0)
    assert np.isfinite(others).all()
    simulations.set_state(task.initial(1, np.random.default_rng(0)), np.array([2]))
    simulations.step(np.zeros_like(task.action_low))
    assert not simulations.diverged.any()


def test_a_cheetah_at_a_million_radians_per_second_has_diverged():
    """After a step it is at 1e118 rad/s, which is finite: a test of the bound itself."""
    task, source = get_task("half_cheetah"), variants_of("half_cheetah")["vanilla"].source
    simulations = Simulations(task, source, 1)
    simulations.set_dynamics(variants_of("half_cheetah")["vanilla"].truth[None])
    state = task.initial(1, np.random.default_rng(0))
    state.qvel[0, -1] = 1e6
    simulations.set_state(state)
    simulations.step(np.zeros(6))
    assert simulations.diverged[0]


@pytest.mark.parametrize("actions", [np.zeros((5, 1)), np.zeros(1), np.full(3, np.nan)])
def test_actions_that_do_not_fit_are_refused(actions):
    task = get_task("hopper")
    simulations = Simulations(task, variants_of("hopper")["vanilla"].source, 5)
    with pytest.raises(InvalidInput, match=r"finite, of shape \(5, 3\)"):
        simulations.step(actions)


class TestLengthsOfAnOwnTask:
    """The example package's rod, its mass first given and then left to its geometry."""

    @pytest.fixture
    def pendulum(self, monkeypatch):
        monkeypatch.syspath_prepend(str(ROOT / "docs/examples/adr-pendulum"))
        return importlib.import_module("adr_pendulum").Pendulum()

    def source(self, *parameters, **fixed):
        space = tuple(Parameter(f"p{i}", a, "1", 0.3, 2.0, 0.1) for i, a in enumerate(parameters))
        return Source(ParameterSpace(space), {f"body:rod.{k}": v for k, v in fixed.items()})

    def test_what_is_fixed_stays_whatever_length_is_drawn(self, pendulum):
        class Heavier(type(pendulum)):
            def reshape(self, spec, lengths):
                super().reshape(spec, lengths)
                spec.body("rod").mass = lengths.get("rod", 1.0)

        source = self.source("link:rod.length", mass=2.5)
        simulations = Simulations(Heavier(), source, 2)
        simulations.set_dynamics(np.array([[0.5], [1.5]]))
        for row, length in enumerate((0.5, 1.5)):
            assert simulations.model(row).body("rod").mass[0] == 2.5
            assert simulations.model(row).geom("rod").size[1] == length / 2

    @pytest.mark.parametrize(
        ("parameters", "fixed", "message"),
        [
            (["link:rodd.length"], {}, "link:rodd.length changes nothing"),
            (["link:rod.length", "body:rod.inertial"], {}, "use body:….mass"),
            (["link:rod.length"], {"inertial": 2.0}, "use body:….mass"),
        ],
    )
    def test_what_would_be_a_wrong_inertia_or_no_change_is_refused(
        self, pendulum, parameters, fixed, message
    ):
        with pytest.raises(InvalidInput, match=message):
            Simulations(pendulum, self.source(*parameters, **fixed), 1)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"xml": ("autoreset", "eulerdamp")}, 'autoreset="disable"'),
            ({"action_low": [-1.0, -1.0]}, "bounds 2 and 1 actions"),
            ({"measured": 4}, "measures 4 of 3 columns"),
        ],
    )
    def test_a_task_whose_parts_do_not_fit_is_refused(self, pendulum, change, message):
        if "xml" in change:
            change = {"xml": pendulum.xml.replace(*change["xml"])}
        task = dataclasses.replace(pendulum, **change)
        with pytest.raises(InvalidInput, match=message):
            Simulations(task, self.source("body:rod.mass"), 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_dynamics_that_are_not_finite_are_refused(bad):
    simulations = Simulations(get_task("arm"), variants_of("arm")["vanilla"].source, 1)
    with pytest.raises(InvalidInput, match="finite"):
        simulations.set_dynamics(np.array([[1.0, bad, 1.0, 1.0]]))


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("body:toso.mass", "did you mean 'torso'"),
        ("body:torso.colour", "accepted: body:….mass"),
        ("torso mass", "kind:name.attribute"),
    ],
)
def test_an_address_that_leads_nowhere_is_explained(address, message):
    with pytest.raises((UnknownName, InvalidInput), match=message):
        resolve(compiled(get_task("hopper").xml), address)


class TestWhatIsRefused:
    """A recording that is not of the task, before it teaches something wrong."""

    data = recordings.recording("arm", 20)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"columns": ("d", "c", "b", "a")}, "the data's columns are d, c, b, a; arm measures"),
            ({"actions": np.full((20, 2), 1.5)}, "20 actions lie outside the bounds of arm, .*1.5"),
            ({"dt": 0.5}, "0.5 s per step; arm has 0.02 s"),
        ],
    )
    def test_a_recording_that_does_not_fit_is_refused(self, changes, message):
        with pytest.raises(InvalidInput, match=message):
            check_recorded(get_task("arm"), dataclasses.replace(self.data, **changes))

    def test_columns_without_names_are_the_tasks(self):
        unnamed = tuple(f"observation_{i}" for i in range(4))
        check_recorded(get_task("arm"), dataclasses.replace(self.data, columns=unnamed))


class TestReplayOfPublishedData:
    """DROPO's Hopper recordings, made with MuJoCo 2.1.0, replayed with the present one."""

    task = get_task("hopper")

    def error(self, data, masses):
        replay = Replay(self.task, variants_of(self.task.name)["vanilla"].source, data, 1, 1)
        return replay.mean_squared_error(np.array([masses]))[0]

    @property
    def truth(self):
        return variants_of(self.task.name)["vanilla"].hidden.values

    def test_the_true_masses_are_the_published_ones(self):
        np.testing.assert_allclose(self.truth, HOPPER_MASSES_KG, atol=5e-9)

    def test_clean_data_are_reproduced_to_rounding(self, hopper_clean):
        assert self.error(hopper_clean, self.truth) < 1e-20

    def test_noisy_data_are_reproduced_to_their_noise(self, hopper_noisy):
        """11 columns of variance 1e-5; the mean square of 10,000 x 11 draws errs by 0.43 %."""
        expected, sampling = 11e-5, np.sqrt(2 / (10_000 * 11))
        assert self.error(hopper_noisy, self.truth) == pytest.approx(expected, rel=4 * sampling)

    def test_masses_wrong_by_a_tenth_are_seen(self, hopper_clean):
        assert self.error(hopper_clean, 1.1 * self.truth) > 1e-4

    def test_a_whole_episode_replays_from_its_first_state(self, hopper_clean):
        first = hopper_clean.split()[0]
        replay = Replay(self.task, variants_of(self.task.name)["vanilla"].source, first, 1, 500)
        assert replay.mean_squared_error(self.truth[None])[0] < 1e-15


class TestEpisodes:
    task = get_task("arm")

    def simulations(self, n):
        source = variants_of(self.task.name)["vanilla"].source
        simulations = Simulations(self.task, source, n)
        simulations.set_dynamics(
            np.tile(variants_of(self.task.name)["vanilla"].hidden.values, (n, 1))
        )
        return simulations

    def test_nothing_is_earned_or_recorded_after_the_end(self):
        """Full power swings the arm over its limit."""
        initial = self.task.initial(3, np.random.default_rng(0))
        episodes = run_episodes(
            self.task, self.simulations(3), lambda o: np.ones((3, 2)), initial, 200
        )
        for row, length in enumerate(episodes.lengths):
            assert 0 < length < 200
            assert np.all(episodes.rewards[row, length:] == 0)
            assert np.isnan(episodes.actions[row, length:]).all()
            assert np.isfinite(episodes.observations[row, : length + 1]).all()
            assert np.isnan(episodes.observations[row, length + 1 :]).all()

    def test_rows_do_not_depend_on_who_stands_beside_them(self):
        initial = self.task.initial(4, np.random.default_rng(0))
        act = lambda o: np.sin(3 * o[:, :2])  # noqa: E731
        together = run_episodes(self.task, self.simulations(4), act, initial, 50)
        alone = run_episodes(
            self.task, self.simulations(1), act, State(initial.qpos[2:3], initial.qvel[2:3]), 50
        )
        np.testing.assert_array_equal(together.observations[2], alone.observations[0])

    def test_noise_is_seen_by_the_policy_and_does_not_move_the_arm(self):
        initial = self.task.initial(2, np.random.default_rng(0))
        still = lambda o: np.zeros((2, 2))  # noqa: E731
        clean = run_episodes(self.task, self.simulations(2), still, initial, 30)
        noisy = run_episodes(
            self.task, self.simulations(2), still, initial, 30, lambda: np.full((2, 4), 0.5)
        )
        np.testing.assert_allclose(noisy.observations, clean.observations + 0.5)
        np.testing.assert_array_equal(noisy.rewards, clean.rewards)

    def test_following_goes_on_after_a_fall(self):
        initial = self.task.initial(3, np.random.default_rng(0))
        seen = follow(self.task, self.simulations(3), lambda o: np.ones((3, 2)), initial, 200)
        assert seen.shape == (3, 201, 4)
        assert np.isfinite(seen).all()


def test_replay_predicts_what_a_rollout_recorded():
    """Closed loop, then open loop with the same actions and dynamics: nothing differs."""
    task, variant = get_task("hopper"), variants_of("hopper")["vanilla"]
    dynamics = np.array([[3.0, 4.0, 2.0, 6.0]])
    simulations = Simulations(task, variant.source, 1)
    simulations.set_dynamics(dynamics)
    act = lambda o: np.sin(10 * o[:, :3])  # noqa: E731
    episode = run_episodes(task, simulations, act, task.initial(1, np.random.default_rng(0)), 40)
    n = int(episode.lengths[0])
    data = TransitionDataset(
        episode.observations[0, :n],
        episode.actions[0, :n],
        episode.observations[0, 1 : n + 1],
        np.zeros(n, dtype=np.int64),
        0.008,
        task.columns,
        "test",
    )
    replay = Replay(task, variant.source, data, 1, 1)
    assert replay.mean_squared_error(dynamics)[0] < 1e-25  # x is put to 0, which rounds


def test_data_of_another_control_period_are_refused(hopper_clean):
    task, source = get_task("hopper"), variants_of("hopper")["vanilla"].source
    slow = dataclasses.replace(hopper_clean, dt=0.02)
    with pytest.raises(InvalidInput, match=r"0.02 s per step; hopper has 0.008 s"):
        Replay(task, source, slow, 1, 1)
