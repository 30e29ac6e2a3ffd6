"""Laws of all methods in the catalogue, with the settings of the preset `smoke`."""

import copy
import json
import re
from functools import cache
from importlib import import_module
from itertools import pairwise

import numpy as np
import pytest
from pydantic import TypeAdapter

from adr_service.errors import InvalidInput
from adr_service.json_values import canonical_json
from adr_service.methods.base import (
    CurriculumSettings,
    Evidence,
    MethodSettings,
    OfflineSettings,
    OnlineSettings,
    ReturnsSettings,
)
from adr_service.methods.catalogue import AnyMethod, methods, name_of
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.presets import PRESETS
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PROBLEM, SPACE, recorded, waving_policy
from tests.recordings import recording

NAMES = list(methods())
OFFLINE = [name for name in NAMES if issubclass(methods()[name], OfflineSettings)]
ONLINE = [name for name in NAMES if issubclass(methods()[name], OnlineSettings)]
CURRICULA = [name for name in NAMES if issubclass(methods()[name], CurriculumSettings)]
BY_RETURNS = [name for name in NAMES if issubclass(methods()[name], ReturnsSettings)]
POLICY = waving_policy()
DATA = recorded(POLICY, episodes=2, steps=15, noise=0.003)

every_method = pytest.mark.parametrize("name", NAMES)
every_inferring = pytest.mark.parametrize("name", OFFLINE + ONLINE)
every_curriculum = pytest.mark.parametrize("name", CURRICULA)
every_online = pytest.mark.parametrize("name", ONLINE)


def settings_of(name, preset="smoke"):
    return methods()[name].model_validate(PRESETS[preset]["methods"].get(name, {}))


def answer(name, rng, data=DATA, progress=silent):
    """The distribution of one inference with the settings of `smoke`, and its cost and facts."""
    method = settings_of(name).create()
    if name in OFFLINE:
        estimate = method.fit(PROBLEM, data, rng, progress)
        return estimate.distribution, estimate.simulated_steps, estimate.diagnostics
    state = method.start(PROBLEM)
    update = method.tell(PROBLEM, state, Evidence(POLICY, data), rng, progress)
    return method.ask(PROBLEM, update.state), update.simulated_steps, update.diagnostics


@cache
def one_answer(name):
    """An answer for laws of single ones, and the progress of its inference."""
    progress = Reported()
    return *answer(name, stream("one answer"), progress=progress), progress


class Reported:
    """Progress that keeps the fractions it was called with."""

    def __init__(self):
        self.fractions = []

    def __call__(self, fraction, checkpoint=None, **facts):
        assert json.dumps(facts)
        self.fractions.append(fraction)


@every_method
def test_a_method_is_catalogued_by_its_name(name):
    assert name_of(methods()[name]) == name
    assert methods()[name]().name == name


@every_method
@pytest.mark.parametrize("preset", PRESETS)
def test_settings_survive_json(name, preset):
    settings = settings_of(name, preset)
    again = TypeAdapter(AnyMethod).validate_json(settings.model_dump_json())
    assert again == settings
    assert type(again) is type(settings)


@every_method
def test_the_program_of_a_method_is_a_module_that_can_run(name):
    assert callable(import_module(methods()[name].program).run)


@every_method
def test_each_expands_the_grid_and_nothing_else(name):
    settings = methods()[name]()
    if settings.grid is None:
        assert settings.each == [settings]
        return
    field = settings.grid.field
    values = getattr(settings, field)
    values = values if isinstance(values, list) else [values]
    assert [getattr(one, field) for one in settings.each] == values
    for one in settings.each:
        assert one.each == [one]
        assert one.model_copy(update={field: getattr(settings, field)}) == settings


def test_the_labels_and_colours_in_figures_are_unique_among_ours():
    ours = [each for each in methods().values() if each.__module__.startswith("adr_service.")]
    labels = [each.label or name_of(each) for each in ours]
    colours = [each.colour for each in ours]
    assert len(set(labels)) == len(labels)
    assert len(set(colours)) == len(colours)
    assert all(re.fullmatch("#[0-9A-F]{6}", colour) for colour in colours)
    assert MethodSettings.colour not in colours


def test_references_stand_at_the_end():
    flags = [each.is_reference for each in methods().values()]
    assert flags == sorted(flags)


@every_inferring
@pytest.mark.parametrize("preset", PRESETS)
def test_planned_steps_are_positive_and_grow_with_transitions(name, preset):
    for settings in settings_of(name, preset).each:
        planned = [settings.planned_steps(len(SPACE), n) for n in (1, 10, 200)]
        assert planned[0] > 0
        assert all(more > less for less, more in pairwise(planned))


@every_inferring
def test_equal_streams_give_equal_answers_whatever_the_global_generator_is(name):
    answers = []
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002
        distribution, *rest = answer(name, stream("same"))
        answers.append((distribution.to_json(), *rest))
    assert answers[0] == answers[1]


@every_inferring
def test_another_stream_gives_another_answer_if_the_method_draws_from_it(name):
    """Latin hypercubes spawn a stream; converged searches may not show from where they started."""
    streams = [stream("one"), stream("other")]
    before = copy.deepcopy(streams[0].bit_generator.state)
    one, other = (answer(name, rng)[0].to_json() for rng in streams)
    has_drawn = streams[0].bit_generator.state != before
    has_spawned = streams[0].bit_generator.seed_seq.n_children_spawned > 0
    assert one != other if has_drawn else one == other or has_spawned


@every_inferring
def test_an_answer_is_over_the_sources_space_with_means_inside_the_search_bounds(name):
    distribution, *_ = one_answer(name)
    assert distribution.space == SPACE
    assert np.all(SPACE.low <= distribution.mean)
    assert np.all(distribution.mean <= SPACE.high)
    draws = distribution.sample(50, np.random.default_rng(0)).values
    assert np.all(draws >= SPACE.feasible_low)


@every_inferring
def test_an_inference_costs_steps_and_its_diagnostics_are_json(name):
    _, steps, diagnostics, _ = one_answer(name)
    assert isinstance(steps, int)
    assert steps > 0
    assert json.loads(json.dumps(diagnostics)) == diagnostics


@pytest.mark.parametrize("name", [name for name, each in methods().items() if each.grid])
def test_every_answer_has_the_criterion_of_the_grid(name):
    _, _, diagnostics, _ = one_answer(name)
    assert np.isfinite(diagnostics[methods()[name].grid.criterion])


@every_inferring
def test_progress_rises_to_at_most_one(name):
    *_, progress = one_answer(name)
    assert progress.fractions
    assert progress.fractions[0] > 0
    assert progress.fractions[-1] <= 1
    assert progress.fractions == sorted(progress.fractions)


@every_inferring
def test_data_of_another_task_are_refused_by_both_widths(name):
    with pytest.raises(InvalidInput, match=r"11 observations and 3 actions; arm measures 4"):
        answer(name, stream("other task"), recording("hopper", 15))


@every_online
def test_the_first_question_is_answered_without_evidence(name):
    method = settings_of(name).create()
    assert method.ask(PROBLEM, method.start(PROBLEM)).space == SPACE
    assert method.start(PROBLEM) == method.start(PROBLEM)


@every_online
def test_state_is_json_and_neither_ask_nor_tell_changes_it(name):
    method = settings_of(name).create()
    state = method.start(PROBLEM)
    before = canonical_json(state)
    asked = method.ask(PROBLEM, state).to_json()
    update = method.tell(PROBLEM, state, Evidence(POLICY, DATA), stream("state"), silent)
    assert canonical_json(state) == before
    assert method.ask(PROBLEM, state).to_json() == asked
    stored = json.loads(canonical_json(update.state))
    assert stored == update.state
    assert method.ask(PROBLEM, stored).to_json() == method.ask(PROBLEM, update.state).to_json()


@every_online
def test_an_update_costs_at_most_what_was_planned(name):
    planned = settings_of(name).planned_steps(len(SPACE), len(DATA))
    _, steps, *_ = one_answer(name)
    assert steps <= planned


# settings with which a curriculum moves within a few phases, where those of `smoke` do not
EARLY = {"epopt": {"skip": 1, "focus": 1}}
STILL = {"fixed_dr"}  # curricula whose distribution never moves


def course_of(name, returns, rng):
    """The distributions of a curriculum, JSON, that is moved by returns (moves, n)."""
    curriculum = settings_of(name).model_copy(update=EARLY.get(name, {})).create(PROBLEM)
    kept = [curriculum.distribution.to_json()]
    for earned in returns:
        dynamics = curriculum.sample(len(earned), rng).values
        assert np.all((dynamics >= SPACE.low) & (dynamics <= SPACE.high))
        curriculum.move(dynamics, earned)
        kept.append(curriculum.distribution.to_json())
    return kept


@every_curriculum
def test_a_curriculum_stays_in_the_search_box_and_repeats_with_its_stream(name):
    returns = PROBLEM.task.reward_threshold * stream("returns").uniform(0, 2, (6, 64))
    kept = course_of(name, returns, stream("draws"))
    assert any(distribution != kept[0] for distribution in kept) == (name not in STILL)
    assert kept == course_of(name, returns, stream("draws"))
    assert kept == json.loads(json.dumps(kept))


@pytest.mark.parametrize("name", BY_RETURNS)
def test_proposals_are_feasible_and_equal_streams_give_equal_ones(name):
    settings = settings_of(name)
    boxes = random_bounds(SPACE, UdrSettings(policies=settings.initial), stream("boxes"))
    returns = stream("returns").normal(size=len(boxes))
    one, other = (
        settings.create().propose(PROBLEM, boxes, returns, stream("proposals")) for _ in range(2)
    )
    assert one.next.to_json() == other.next.to_json()
    assert 0 <= one.best < len(boxes)
    assert json.dumps(one.diagnostics) == json.dumps(other.diagnostics)
    assert np.all(one.next.sample(100, stream("draws")).values >= SPACE.feasible_low)
    assert settings.seconds > 0
