"""The check of tasks names the rule that a broken task breaks."""

import re
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from adr_service.arrays import frozen
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.base import Entry, Hidden, Source, State, Variant
from adr_service.tasks.catalogue import BUILT_IN
from adr_service.tasks.check import check_task

SLIDERS = """
<mujoco><option timestep=".01"><flag warmstart="disable" autoreset="disable"/></option>
<worldbody>
<body name="upper"><joint name="shoulder" type="slide"/><geom size=".1" mass="1"/></body>
<body name="fore" pos="0 1 0"><joint name="elbow" type="slide"/><geom size=".1" mass="1"/></body>
</worldbody>
<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>
"""


def arm_with(parameters, fixed=None, names=None, xml=None):
    """The arm with parameters of these addresses, truths and feasible minima."""
    space = ParameterSpace(
        tuple(
            Parameter(names[i] if names else address, address, "1", least, truth + 1, least)
            for i, (address, truth, least) in enumerate(parameters)
        )
    )
    source = Source(space, fixed or {})
    hidden = Hidden(source, frozen([truth for _, truth, _ in parameters]), 0.0)
    arm = type(BUILT_IN["arm"].task)
    task = arm() if xml is None else type("Changed", (arm,), {"xml": xml})()
    return Entry(task, {"vanilla": Variant(source, hidden)})


@pytest.mark.parametrize(
    ("function", "wrong", "message"),
    [
        ("observe", lambda self, state: state.qpos, r"observe gave shape \(10, 2\) .* \(10, 4\)"),
        ("reward", lambda self, b, a, s: np.zeros((10, 1)), r"reward gave shape \(10, 1\)"),
        ("terminated", lambda self, state: np.zeros(1), "terminated gave shape"),
        ("state", lambda self, o: State(o[:, :2] + 1, o[:, 2:]), "must give the measured columns"),
        (
            "reward",
            lambda self, b, a, s: np.full(len(a), np.nan),
            "reward must be finite; it gave .nan",
        ),
        (
            "reward",
            lambda self, b, a, s: np.where(np.abs(s.qpos[:, 0]) > 0.4, np.nan, 1.0),
            "reward must be finite",
        ),
        ("reward", lambda self, b, a, s: {}["rod"], "KeyError: 'rod'"),
        (
            "terminated",
            lambda self, state: np.zeros(len(state.qpos)),
            "must give booleans; it gave float64",
        ),
        (
            "initial",
            lambda self, n, rng: State(np.zeros(2), np.zeros(2)),
            r"initial's qpos gave shape \(2,\) for 10 states; expected is \(10, 2\)",
        ),
        (
            "initial",
            lambda self, n, rng: State(
                np.random.default_rng().normal(size=(n, 2)), np.zeros((n, 2))
            ),
            "must draw from the generator .*; the same seed gave other states",
        ),
        (
            "initial",
            lambda self, n, rng: State(
                np.random.default_rng(3).normal(size=(n, 2)), np.ones((n, 2))
            ),
            "must draw from the generator .*; its states vary, but not with the seed",
        ),
        (
            "terminated",
            lambda self, state: np.abs(state.qpos[:, 0]) < 0.1,
            "terminated must be false in states that initial gives",
        ),
        (
            "terminated",
            lambda self, state: np.full(len(state.qpos), abs(state.qpos[0, 0]) > 0.4),
            "terminated must treat every simulation by itself; row 9 of 10 gave",
        ),
        (
            "reward",
            lambda self, b, a, s: np.full(len(a), s.qpos[0, 0]),
            "reward must treat every simulation by itself; row 9 of 10 gave",
        ),
        (
            "observe",
            lambda self, s: np.hstack([s.qpos, np.tile(s.qvel[-1], (len(s.qvel), 1))]),
            "observe must treat every simulation by itself; row 0 of 10 gave",
        ),
        (
            "reward",
            lambda self, before, a, after: np.square(after.qpos, out=after.qpos)[:, 0],
            "reward must not write into its arguments",
        ),
        ("xml", "<mujoco><nothing/></mujoco>", "MuJoCo cannot compile the model"),
    ],
)
def test_a_task_that_breaks_a_rule_is_named_with_the_rule(function, wrong, message):
    arm = BUILT_IN["arm"]
    broken = type("Broken", (type(arm.task),), {function: wrong})()
    with pytest.raises(InvalidInput, match=f"task 'arm': .*{message}"):
        check_task(Entry(broken, arm.variants))


@pytest.mark.parametrize("threshold", [-3.75, 0.0, float("nan"), float("inf")])
def test_a_threshold_by_which_returns_cannot_be_divided_is_refused(threshold):
    """Divided by a negative one, the worst policy would be the best."""
    arm = BUILT_IN["arm"]
    with pytest.raises(InvalidInput, match=f"must be positive and finite; given {threshold}"):
        check_task(Entry(replace(arm.task, reward_threshold=threshold), arm.variants))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"horizon": 0}, "horizon must be a whole number of 1 or more; given 0"),
        ({"horizon": 1.5}, "horizon must be a whole number of 1 or more; given 1.5"),
        ({"learning_rate": 0.0}, "learning_rate must be positive and finite; given 0.0"),
        ({"learning_rate": np.nan}, "learning_rate must be positive and finite; given nan"),
        ({"learning_rate": np.inf}, "learning_rate must be positive and finite; given inf"),
        ({"frame_skip": 0}, "frame_skip must be a whole number of 1 or more; given 0"),
        ({"action_high": np.array([1.0, -1.0])}, "action_low must be below action_high"),
        (
            {"action_high": np.array([1.0, 2.0])},
            "action 1 has the bounds -1 to 2, beyond the ctrlrange of its actuator, -1 to 1",
        ),
        ({"action_high": np.array([1.0, np.inf])}, "action_low must be below .* and both finite"),
        ({"columns": ("a", "b", "b", "c")}, "columns must have names of their own; twice: b"),
        ({"columns": ("a", "b", "c\n", "d")}, r"the name of a column .* given 'c\\n'"),
    ],
)
def test_numbers_that_no_task_has_are_refused(changed, message):
    arm = BUILT_IN["arm"]
    task = copy(arm.task)
    for name, value in changed.items():
        object.__setattr__(task, name, value)
    with pytest.raises(InvalidInput, match=f"task 'arm': {message}"):
        check_task(Entry(task, arm.variants))


def test_a_target_that_is_not_the_oracles_simulator_is_refused():
    """The oracle is trained on vanilla's source, so that the upper reference would be wrong."""
    arm = BUILT_IN["arm"]
    vanilla = arm.variants["vanilla"]
    heavy = replace(vanilla.hidden.source, fixed={"joint:*.armature": 5.0})
    geared = replace(vanilla, hidden=replace(vanilla.hidden, source=heavy))
    with pytest.raises(InvalidInput, match=r"'geared' has the fixed values .*'vanilla'.* the same"):
        check_task(Entry(arm.task, {**arm.variants, "geared": geared}))


def test_a_task_without_variants_is_refused():
    with pytest.raises(InvalidInput, match="task 'arm': it has no variant"):
        check_task(Entry(BUILT_IN["arm"].task, {}))


def test_bounds_of_actions_may_be_rounded_to_float32():
    arm = BUILT_IN["arm"]
    task = copy(arm.task)
    object.__setattr__(task, "action_high", np.array([1.0, 1 + 1e-7]))
    check_task(Entry(task, arm.variants))


def test_bounds_of_actions_are_free_where_the_model_limits_no_control():
    arm = BUILT_IN["arm"]
    task = copy(arm.task)
    assert 'warmstart="disable"' in task.xml
    free = task.xml.replace('warmstart="disable"', 'warmstart="disable" clampctrl="disable"')
    unclamped = type("Unclamped", (type(task),), {"xml": free})()
    object.__setattr__(unclamped, "action_high", np.array([1.0, 2.0]))
    check_task(Entry(unclamped, arm.variants))


@pytest.mark.parametrize("variance", [-1e-4, float("nan"), float("inf")])
def test_a_noise_variance_that_no_noise_has_is_refused(variance):
    arm = BUILT_IN["arm"]
    noisy = arm.variants["noisy"]
    wrong = replace(noisy, hidden=replace(noisy.hidden, noise_variance=variance))
    with pytest.raises(InvalidInput, match=f"'noisy' must be 0 or more, and finite; .* {variance}"):
        check_task(Entry(arm.task, {**arm.variants, "noisy": wrong}))


def test_a_truth_below_the_feasible_minimum_is_refused():
    arm = BUILT_IN["arm"]
    vanilla = arm.variants["vanilla"]
    parameter = vanilla.hidden.source.space.parameters[0]
    values = vanilla.hidden.values.copy()
    values[0] = parameter.feasible_low / 2
    light = replace(vanilla, hidden=replace(vanilla.hidden, values=values))
    message = f"truth of {parameter.name} in the variant 'light' is {values[0]:g}, below its"
    with pytest.raises(InvalidInput, match=message):
        check_task(Entry(arm.task, {**arm.variants, "light": light}))


@pytest.mark.parametrize("name", ["", " ", "\n", "\x1b[31mred"])
def test_names_that_no_line_can_show_are_refused(name):
    arm = BUILT_IN["arm"]
    refusal = "the name of a {} must be a line of text; given "
    with pytest.raises(InvalidInput, match=refusal.format("task")):
        check_task(Entry(replace(arm.task, name=name), arm.variants))
    with pytest.raises(InvalidInput, match=refusal.format("variant")):
        check_task(Entry(arm.task, {**arm.variants, name: arm.variants["noisy"]}))
    with pytest.raises(InvalidInput, match=refusal.format("parameter")):
        check_task(arm_with([("body:upper.mass", 1.0, 0.1)], names=[name]))


def test_a_variant_whose_name_a_domain_would_cut_is_refused():
    arm = BUILT_IN["arm"]
    with pytest.raises(InvalidInput, match="the variant 'noisy@home' has an @ in its name"):
        check_task(Entry(arm.task, {**arm.variants, "noisy@home": arm.variants["noisy"]}))


@pytest.mark.parametrize("letter", list("/\\?#%"))
def test_a_variant_that_no_figure_can_be_named_after_is_refused(letter):
    arm, name = BUILT_IN["arm"], f"low{letter}high"
    with pytest.raises(InvalidInput, match=re.escape(f"{name!r} has {letter} in its name")):
        check_task(Entry(arm.task, {**arm.variants, name: arm.variants["noisy"]}))


def test_a_variant_in_which_nothing_is_unknown_is_refused():
    with pytest.raises(InvalidInput, match="source of the variant 'vanilla' has no parameter"):
        check_task(arm_with([]))


def test_a_start_that_is_always_the_same_is_accepted():
    arm = BUILT_IN["arm"]
    home = type(
        "Home",
        (type(arm.task),),
        {"initial": lambda self, n, rng: State(np.zeros((n, 2)), np.zeros((n, 2)))},
    )
    check_task(Entry(home(), arm.variants))


def test_a_reward_may_be_undefined_where_the_episode_has_ended():
    """Such states are simulated by the check alone."""
    arm = BUILT_IN["arm"]
    narrow = type(
        "Narrow",
        (type(arm.task),),
        {
            "reward": lambda self, b, a, s: np.where(np.abs(b.qpos[:, 0]) < 0.4, 1.0, np.nan),
            "terminated": lambda self, s: ~(np.abs(s.qpos[:, 0]) < 0.4),
        },
    )
    check_task(Entry(narrow(), arm.variants))


@pytest.mark.parametrize(
    ("addresses", "fixed", "message"),
    [
        (
            ["body:fore.mass", "body:fore.inertial"],
            {},
            r"body:fore.mass and body:fore.inertial both set body_mass\[2\]",
        ),
        (
            ["joint:elbow.damping", "joint:*.damping"],
            {},
            r"joint:elbow.damping and joint:\*.damping both set dof_damping\[1\]",
        ),
        (
            ["body:fore.inertial"],
            {"body:*.mass": 2.0},
            r"body:\*.mass and body:fore.inertial both set body_mass\[2\]",
        ),
        (
            ["link:fore.length"],
            {"link:fore.length": 1.0},
            "link:fore.length and link:fore.length both set",
        ),
    ],
)
def test_a_value_that_two_addresses_set_is_refused_with_both(addresses, fixed, message):
    with pytest.raises(InvalidInput, match=message):
        check_task(arm_with([(address, 1.0, 0.1) for address in addresses], fixed))


def test_a_parameter_may_set_anew_what_a_fixed_value_sets_everywhere():
    check_task(arm_with([("body:fore.mass", 1.0, 0.1)], {"body:*.mass": 2.0}))


def test_one_address_of_two_parameters_is_refused():
    twice = arm_with([("body:fore.mass", 1.0, 0.1)] * 2, names=["mass", "weight"])
    with pytest.raises(InvalidInput, match=r"body:fore.mass and body:fore.mass both set"):
        check_task(twice)


def test_the_mass_of_what_stands_on_the_ground_is_refused_as_a_parameter():
    base = '<body name="base"><geom type="sphere" size=".1" mass="1"/></body></worldbody>'
    xml = BUILT_IN["arm"].task.xml.replace("</worldbody>", base)
    with pytest.raises(InvalidInput, match=r"\(body:base.mass\) changes no measured column"):
        check_task(arm_with([("body:base.mass", 1.0, 0.1)], xml=xml))


@pytest.mark.parametrize(
    ("address", "least", "message"),
    [
        ("body:*.mass", 0.0, "MuJoCo refuses the feasible_low of all parameters: .* has 0 mass"),
        (
            "body:fore.mass",
            -0.5,
            "at the feasible_low of all parameters, the body 'fore' has the negative mass -0.5 kg",
        ),
        (
            "joint:*.armature",
            -1.0,
            "the simulation diverges within 5 steps at the feasible_low of all parameters",
        ),
    ],
)
def test_a_feasible_minimum_that_cannot_be_simulated_is_refused(address, least, message):
    with pytest.raises(InvalidInput, match=message):
        check_task(arm_with([(address, 1.0, least)], xml=SLIDERS))


def test_a_task_without_the_vanilla_variant_is_refused():
    arm = BUILT_IN["arm"]
    with pytest.raises(InvalidInput, match=r"no variant 'vanilla'.* it has noisy"):
        check_task(Entry(arm.task, {"noisy": arm.variants["noisy"]}))
