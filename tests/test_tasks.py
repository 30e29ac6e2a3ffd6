"""The contract of every task, over the catalogue; and what is Hopper's own."""

import mujoco
import numpy as np
import pytest

from adr_service.errors import UnknownName
from adr_service.simulation.batch import Simulations, compiled
from adr_service.simulation.model import resolve
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import TASKS, VARIANTS, get_task, source_of

CASES = [(task, name) for task in TASKS.values() for name in VARIANTS[task.name]]
IDS = [f"{task.name}-{name}" for task, name in CASES]


@pytest.fixture(params=TASKS.values(), ids=TASKS.keys())
def task(request):
    return request.param


@pytest.fixture
def visited(task):
    """States that random actions lead to."""
    rng = np.random.default_rng(0)
    source = VARIANTS[task.name]["vanilla"].source
    simulations = Simulations(task, source, 8)
    simulations.set_dynamics(np.tile((source.space.low + source.space.high) / 2, (8, 1)))
    simulations.set_state(task.initial(8, rng))
    for _ in range(20):
        simulations.step(rng.uniform(task.action_low, task.action_high, (8, len(task.action_low))))
    return simulations.state


def test_every_task_has_the_three_variants(task):
    assert list(VARIANTS[task.name]) == ["vanilla", "noisy", "unmodeled"]


def test_observing_the_state_of_an_observation_gives_it_back(task, visited):
    observations = task.observe(visited)
    assert observations.shape == (8, len(task.columns))
    np.testing.assert_allclose(task.observe(task.state(observations)), observations, atol=1e-12)


def test_initial_states_are_alive_and_repeat_with_the_seed(task):
    first = task.initial(50, np.random.default_rng(3))
    assert not task.terminated(first).any()
    np.testing.assert_array_equal(first.qpos, task.initial(50, np.random.default_rng(3)).qpos)


def test_a_state_that_is_not_finite_ends_the_episode(task):
    state = task.initial(1, np.random.default_rng(0))
    assert task.terminated(State(np.full_like(state.qpos, np.nan), state.qvel)).all()


@pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)
def test_each_parameter_lands_in_its_own_place_of_the_model(task, variant):
    """Per simulation, and in nobody else's."""
    source = VARIANTS[task.name][variant].source
    middle = (source.space.low + source.space.high) / 2
    for index, parameter in enumerate(source.space.parameters):
        simulations = Simulations(task, source, 2)
        values = np.tile(middle, (2, 1))
        values[1, index] = source.space.high[index]
        simulations.set_dynamics(values)
        slot = resolve(compiled(task.xml), parameter.address)
        field = simulations.model_field(slot.field)
        assert field[(0, *slot.index)] == middle[index]
        assert field[(1, *slot.index)] == source.space.high[index]
        others = np.delete(field[0].ravel(), np.ravel_multi_index(slot.index, field[0].shape))
        changed = np.delete(field[1].ravel(), np.ravel_multi_index(slot.index, field[0].shape))
        np.testing.assert_array_equal(others, changed)


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS.keys())
def test_frozen_parameters_are_at_four_fifths_and_stay_there(task):
    """Whatever is drawn for the others (random-envs loses them at the first draw)."""
    unmodeled, vanilla = VARIANTS[task.name]["unmodeled"], VARIANTS[task.name]["vanilla"]
    truth = dict(zip(vanilla.source.space.parameters, vanilla.hidden.values.tolist(), strict=True))
    frozen = {p.address: v for p, v in truth.items() if p.address in unmodeled.source.fixed}
    assert frozen
    simulations = Simulations(task, unmodeled.source, 1)
    for level in (0.25, 0.75):
        space = unmodeled.source.space
        simulations.set_dynamics((space.low + level * (space.high - space.low))[None])
        for address, value in frozen.items():
            slot = resolve(compiled(task.xml), address)
            found = simulations.model_field(slot.field)[(0, *slot.index)]
            assert found == pytest.approx(0.8 * value, rel=1e-15)


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS.keys())
def test_the_truth_is_what_the_model_file_says(task):
    hidden = VARIANTS[task.name]["vanilla"].hidden
    model = compiled(task.xml)
    for parameter, value in zip(hidden.source.space.parameters, hidden.values, strict=True):
        slot = resolve(model, parameter.address)
        assert getattr(model, slot.field)[slot.index] == pytest.approx(value, rel=1e-15)


def test_an_unknown_task_or_variant_is_named_with_what_there_is():
    with pytest.raises(UnknownName, match="did you mean 'hopper'"):
        get_task("hoper")
    with pytest.raises(UnknownName, match="vanilla, noisy, unmodeled"):
        source_of("arm", "windy")


class TestHopper:
    """Against Tiboni et al., Table 1, and MuJoCo 2.1.0's capsule formulas."""

    task = get_task("hopper")

    def test_dimensions_are_the_papers(self):
        assert len(self.task.columns) == 11
        assert len(self.task.action_low) == 3
        assert len(VARIANTS[self.task.name]["vanilla"].source.space) == 4
        assert len(VARIANTS[self.task.name]["unmodeled"].source.space) == 3
        assert VARIANTS[self.task.name]["noisy"].hidden.noise_variance == 1e-4

    def test_masses_and_inertias_are_those_of_a_cylinder_longer_by_a_radius(self):
        model = compiled(self.task.xml)
        for body, geom in [(link, f"{link}_geom") for link in ("torso", "thigh", "leg", "foot")]:
            radius, half = model.geom(geom).size[:2]
            length = 2 * half + radius
            mass = 1000 * np.pi * radius**2 * length
            assert model.body(body).mass[0] == pytest.approx(mass, rel=1e-14)
            across = mass * (3 * radius**2 + length**2) / 12
            expected = [across, across, mass * radius**2 / 2]
            np.testing.assert_allclose(model.body(body).inertia, expected, rtol=1e-14)

    def test_control_period_is_eight_milliseconds(self):
        model = compiled(self.task.xml)
        assert model.opt.timestep * self.task.frame_skip == pytest.approx(0.008)
        assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4

    def test_reward_is_speed_plus_one_minus_effort(self):
        before = self.task.initial(1, np.random.default_rng(0))
        after = State(before.qpos + np.array([[0.016, 0, 0, 0, 0, 0]]), before.qvel)
        action = np.array([[1.0, -1.0, 0.5]])
        expected = 0.016 / 0.008 + 1 - 1e-3 * 2.25
        assert self.task.reward(before, action, after)[0] == pytest.approx(expected)

    @pytest.mark.parametrize(
        ("coordinate", "value", "ended"),
        [(1, 0.71, False), (1, 0.69, True), (2, 0.19, False), (2, 0.21, True), (3, 101.0, True)],
    )
    def test_it_has_fallen_when_too_low_too_tilted_or_out_of_bounds(self, coordinate, value, ended):
        state = self.task.initial(1, np.random.default_rng(0))
        qpos = state.qpos.copy()
        qpos[0, coordinate] = value
        assert self.task.terminated(State(qpos, state.qvel))[0] == ended
