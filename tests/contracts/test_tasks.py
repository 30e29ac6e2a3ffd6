"""The contract of every task and variant, over the whole catalogue."""

import mujoco
import numpy as np
import pytest
from mujoco.batch import MODEL_FIELDS

from adr_service.simulation.batch import Simulations
from adr_service.simulation.model import compiled, link_of, resolve
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import BUILT_IN, hidden_of, source_of, variants_of
from adr_service.tasks.check import check_task
from tests.plain import model_of
from tests.tasks.cases import CASES, IDS, NAMES, TASKS

every_task = pytest.mark.parametrize("task", TASKS, ids=NAMES)
every_variant = pytest.mark.parametrize(("task", "variant"), CASES, ids=IDS)


def moved(task, n=8, steps=20):
    """Simulations at the truth after random actions."""
    rng, hidden = np.random.default_rng(0), hidden_of(task.name, "vanilla")
    simulations = Simulations(task, hidden.source, n)
    simulations.set_dynamics(np.tile(hidden.values, (n, 1)))
    simulations.set_state(task.initial(n, rng))
    for _ in range(steps):
        simulations.step(rng.uniform(task.action_low, task.action_high, (n, len(task.action_low))))
    return simulations


def row_of(state, row):
    return State(*(values[row : row + 1] for values in state))


@pytest.mark.parametrize("name", NAMES)
def test_every_task_passes_the_check_of_the_doctor(name):
    check_task(BUILT_IN[name])


@every_task
def test_every_task_has_the_three_variants_and_two_where_the_search_ends_too_early(task):
    variants = variants_of(task.name)
    assert list(variants) == ["vanilla", "noisy", "unmodeled", "edge", "outside"]
    frozen = set(variants["vanilla"].source.space.names) - {
        *variants["unmodeled"].source.space.names
    }
    for name in ("edge", "outside"):
        assert set(variants[name].source.space.at_bound(variants[name].truth)) == frozen


@every_task
def test_every_column_names_its_unit(task):
    assert all(column.endswith("]") for column in task.columns)


@every_task
def test_the_state_needs_the_measured_columns_alone(task):
    observations = task.observe(moved(task).state)
    whole, measured = task.state(observations), task.state(observations[:, : task.measured])
    np.testing.assert_array_equal(whole.qpos, measured.qpos)
    np.testing.assert_array_equal(whole.qvel, measured.qvel)


@every_task
def test_initial_states_differ_from_seed_to_seed(task):
    one, other = (task.initial(5, np.random.default_rng(seed)) for seed in (3, 4))
    assert np.any(one.qpos != other.qpos)


@every_task
def test_actions_beyond_their_bounds_act_as_at_the_bounds(task):
    simulations = moved(task, n=4)
    state = simulations.state
    rows = np.array([task.action_high, 3 * task.action_high, task.action_low, 3 * task.action_low])
    simulations.set_state(State(state.qpos[[0] * 4], state.qvel[[0] * 4]))
    simulations.step(rows)
    qvel = simulations.state.qvel
    np.testing.assert_array_equal(qvel[[0, 2]], qvel[[1, 3]])
    assert np.any(qvel[0] != qvel[2])


@every_variant
def test_the_batch_equals_a_plain_loop_bit_for_bit(task, variant):
    source, rng = source_of(task.name, variant), np.random.default_rng(0)
    draws = rng.uniform(source.space.low, source.space.high, (5, len(source.space)))
    initial = task.initial(5, rng)
    actions = rng.uniform(task.action_low, task.action_high, (60, 5, len(task.action_low)))
    simulations = Simulations(task, source, 5)
    simulations.set_dynamics(draws)
    simulations.set_state(initial)
    states = []
    for row in actions:
        simulations.step(row)
        states.append(np.concatenate(simulations.state, axis=1))
    for i, draw in enumerate(draws):
        expected = plain_loop(task, model_of(task, source, draw), row_of(initial, i), actions[:, i])
        np.testing.assert_array_equal([state[i] for state in states], expected)


def plain_loop(task, model, initial, actions):
    """States over time (steps, nq + nv + derived) of one MjData, stepped by a loop."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = initial.qpos[0], initial.qvel[0]
    rows = []
    for action in actions:
        data.ctrl[:] = action
        for _ in range(task.frame_skip):
            mujoco.mj_step(model, data)
        derived = [getattr(data, name).ravel() for name in task.derived]
        rows.append(np.concatenate([data.qpos, data.qvel, *derived]))
    return rows


DERIVED = {  # by mj_setConst
    "actuator_acc0",
    "body_invweight0",
    "body_subtreemass",
    "cam_poscom0",
    "dof_M0",
    "dof_invweight0",
    "dof_length",
    "light_poscom0",
}
GEOMETRY = {
    "body_inertia",
    "body_ipos",
    "body_pos",
    "body_sameframe",
    "bvh_aabb",
    "geom_aabb",
    "geom_pos",
    "geom_rbound",
    "geom_sameframe",
    "geom_size",
}


def differing(one, other):
    arrays = (name for name in MODEL_FIELDS if not name.startswith("opt."))
    return {n for n in arrays if not np.array_equal(getattr(one, n), getattr(other, n))}


@every_variant
def test_each_parameter_lands_where_its_address_says_and_nowhere_else(task, variant):
    """In its own simulation alone; besides, only fields that MuJoCo derives from it change."""
    source = source_of(task.name, variant)
    middle = (source.space.low + source.space.high) / 2
    for index, parameter in enumerate(source.space.parameters):
        simulations = Simulations(task, source, 2)
        values = np.tile(middle, (2, 1))
        values[1, index] = source.space.high[index]
        simulations.set_dynamics(values)
        one, other = simulations.model(0), simulations.model(1)
        if link_of(parameter.address):
            allowed = GEOMETRY | DERIVED
        else:
            slot = resolve(compiled(task.xml), parameter.address)
            for element in slot.elements:
                assert getattr(one, slot.field)[element] == middle[index]
                assert getattr(other, slot.field)[element] == source.space.high[index]
                getattr(other, slot.field)[element] = middle[index]
            allowed = DERIVED if slot.scaled is None else DERIVED | {slot.scaled}
        assert differing(one, other) <= allowed, parameter.name


@every_variant
def test_a_draw_is_the_model_that_is_compiled_afresh(task, variant):
    """Field by field, whatever was drawn before."""
    source, rng = source_of(task.name, variant), np.random.default_rng(0)
    simulations = Simulations(task, source, 3)
    for _ in range(3):
        draws = rng.uniform(source.space.low, source.space.high, (3, len(source.space)))
        simulations.set_dynamics(draws)
    for row, draw in enumerate(draws):
        assert not differing(simulations.model(row), model_of(task, source, draw))


@every_task
def test_frozen_parameters_are_at_four_fifths_of_the_truth_and_stay_there(task):
    """Whatever is drawn for the others (random-envs loses them at the first draw)."""
    unmodeled, vanilla = variants_of(task.name)["unmodeled"], variants_of(task.name)["vanilla"]
    names = [n for n in vanilla.source.space.names if n not in unmodeled.source.space.names]
    assert len(names) == {"half_cheetah": 3, "walker2d": 4, "humanoid": 7}.get(task.name, 1)
    truth = dict(zip(vanilla.source.space.names, vanilla.hidden.values.tolist(), strict=True))
    simulations = Simulations(task, unmodeled.source, 1)
    for level in (0.25, 0.75):
        space = unmodeled.source.space
        values = space.low + level * (space.high - space.low)
        simulations.set_dynamics(values[None])
        drawn = dict(zip(space.names, values.tolist(), strict=True))
        frozen = {name: 0.8 * truth[name] for name in names}
        whole = [(drawn | frozen)[name] for name in vanilla.source.space.names]
        assert not differing(simulations.model(0), model_of(task, vanilla.source, whole))


@every_task
def test_the_truth_is_in_the_model_file(task):
    hidden = hidden_of(task.name, "vanilla")
    file, true = compiled(task.xml), model_of(task, hidden.source, hidden.values)
    for name in differing(file, true):
        np.testing.assert_allclose(getattr(file, name), getattr(true, name), rtol=1e-12, atol=1e-15)
