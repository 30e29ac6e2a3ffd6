"""From a measurement to a verdict: planted effects are named, and nothing else is."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.blind_test.planting import draw_case, hide
from adr_service.criticism import pipeline, revision
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import (
    _confidence_in,
    _confidence_without,
    _opened,
    _Outcome,
    criticise,
    extended,
    split,
)
from adr_service.criticism.report import FILES, files_of
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.verdict import NamedCause
from adr_service.criticism.weighing import Weighed
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace
from tests.hidden import arm, driven, recorded

# frozen before any threshold was chosen: the seeds of a battery on the small task
BATTERY = range(100, 106)


LINK = """
<mujoco>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 1 0" damping="0.1" stiffness="0"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="shoulder" gear="5"/>
  </actuator>
</mujoco>
"""


def swings(stiffness, noise):
    """Arrays of a link with a spring [N m/rad], as `driven` has them."""
    model = mujoco.MjModel.from_xml_string(LINK)
    model.jnt_stiffness[0] = stiffness
    return driven(model, noise)


def verdict_on(arrays, episodes=12):
    nominal, data = Nominal.of_model(LINK, ParameterSpace(())), Measurement(**arrays)
    data = data.episodes(range(episodes))
    return criticise(nominal, data, np.random.default_rng(0), threads=1).verdict


def case(seed, ratio=0.3, **how):
    return draw_case(*arm(), np.random.default_rng(seed), ratio, **how)


@pytest.mark.slow
@pytest.mark.parametrize("seed", BATTERY)
def test_a_hidden_effect_is_named_or_tied_with_what_equals_it(seed):
    hidden = case(seed)
    found = criticise(hidden.nominal, hidden.measurement, np.random.default_rng(0), threads=1)
    assert_named(found.verdict, hidden)


def test_the_least_that_is_accepted_is_enough(criticism):
    """Two of the eight episodes are sealed."""
    assert_named(criticism.verdict, case(100))
    assert criticism.verdict.residual.used == 6 * 75


def assert_named(verdict, hidden):
    (cause,) = hidden.effects
    assert verdict.conclusion in ("cause", "tie")
    assert len(verdict.causes) == 1
    named = {(c.kind, c.location) for c in (verdict.causes[0], *verdict.tied[0])}
    assert (cause.kind, cause.location) in named
    assert verdict.gain.low < verdict.gain.sse_removed < verdict.gain.high


def test_where_nothing_is_hidden_the_verdict_has_only_detection_limits(nothing):
    hidden, found = nothing
    assert found.verdict.conclusion == "none"
    assert found.extension is None
    assert found.verdict.gain is None
    limits = found.verdict.residual.detectable
    size, unit = limits["joint_coulomb_friction joint:elbow"]
    assert (0 < size < 0.1, unit) == (True, "N m")  # of a motor of 12
    # the parameters were off by up to 10 %, and are found
    np.testing.assert_allclose(found.final.parameters, hidden.truth, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [200, 201])
def test_nothing_is_named_in_all_episodes_where_nothing_is_hidden(seed):
    hidden = case(seed, count=0)
    found = criticise(hidden.nominal, hidden.measurement, np.random.default_rng(0), threads=1)
    assert found.verdict.conclusion == "none"
    np.testing.assert_allclose(found.final.parameters, hidden.truth, rtol=0.01)


@pytest.mark.slow
def test_velocities_that_nobody_measured_may_be_zeros():
    spring = swings(stiffness=1.5, noise=1e-4)
    spring["qvel"][:] = 0.0
    verdict = verdict_on({**spring, "qvel_std": np.inf}, episodes=8)
    assert [cause.kind for cause in verdict.causes] == ["joint_spring"]


@pytest.mark.slow
def test_where_data_have_no_noise_errors_of_computing_them_are_no_evidence():
    assert verdict_on(swings(stiffness=0.0, noise=0.0), 8).conclusion == "none"


@pytest.mark.parametrize(
    ("seed", "ratio", "effect"),
    [
        pytest.param(300, 1.0, "gain_drift", marks=pytest.mark.slow),
        (301, 0.3, "disturbance"),
    ],
)
def test_an_effect_that_is_not_in_the_catalogue_is_called_unknown(seed, ratio, effect):
    hidden = case(seed, ratio=ratio, outside=True)
    assert hidden.outside == effect
    found = criticise(hidden.nominal, hidden.measurement, np.random.default_rng(0), threads=1)
    assert found.verdict.conclusion == "unknown"
    assert found.verdict.confidence > 0.99  # its own, and not a cause's
    assert not found.verdict.causes
    if effect == "disturbance":
        where = found.verdict.residual.where
        assert where.depends_on == "frequency"
        assert where.hertz == pytest.approx(2.7, rel=0.002)


def test_an_encoders_scale_is_one_cause_in_position_and_velocity():
    hidden = Effect("joint_encoder_scale", "joint:elbow", (0.005,))
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(2), [hidden]).episodes(range(12))
    found = criticise(nominal, data, np.random.default_rng(0), threads=1).verdict
    (cause,) = found.causes
    assert (cause.kind, cause.location) == (hidden.kind, hidden.location)
    assert cause.strengths[0].low < 0.005 < cause.strengths[0].high


@pytest.mark.slow
def test_a_second_cause_is_named_beside_the_first():
    """The first looks like a group, `sensor:*`, until the second is known."""
    hidden = [
        Effect("sensor_delay", "sensor:shoulder.position", (0.0006,)),
        Effect("joint_armature", "joint:elbow", (0.0005,)),
    ]
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(400), hidden)
    found = criticise(
        nominal, data.episodes(range(20)), np.random.default_rng(0), threads=1
    ).verdict
    assert found.conclusion == "cause"
    assert len(found.causes) == 2
    for cause in hidden:
        (named,) = (n for n in found.causes if (n.kind, n.location) == (cause.kind, cause.location))
        assert named.strengths[0].value == pytest.approx(cause.values[0], rel=0.05)


@pytest.mark.slow
def test_what_the_sealed_episodes_refute_is_not_named():
    """A spring in the episodes to learn from, the opposite of it in the sealed ones."""
    task, nominal = arm()
    stiff, soft = (
        recorded(
            hide(
                task,
                nominal,
                np.random.default_rng(402),
                [Effect("joint_spring", "joint:elbow", (k,))],
            )
        )
        for k in (0.5, -0.5)
    )
    is_sealed = stiff["episode"] % 4 == 3
    data = Measurement(
        **{name: np.where(is_sealed, soft[name].T, stiff[name].T).T for name in stiff}
    )
    found = criticise(nominal, data, np.random.default_rng(0), threads=1)
    assert found.verdict.conclusion == "unknown"  # by the flexible force
    assert "joint_spring joint:elbow" in found.verdict.remarks[0]
    assert not found.verdict.causes
    assert found.verdict.gain is None
    assert found.extension is None


@pytest.mark.slow
def test_of_many_episodes_a_part_chooses_the_step_and_all_are_judged(friction):
    parts = [recorded(hide(*arm(), np.random.default_rng(n), [friction])) for n in (405, 406)]
    parts[1] = {**parts[1], "episode": parts[1]["episode"] + 30}
    data = Measurement(**{name: np.concatenate([p[name] for p in parts]) for name in parts[0]})
    found = criticise(arm()[1], data, np.random.default_rng(0), threads=1)
    assert found.verdict.causes[0].kind == friction.kind
    learned, _ = split(data)
    assert len(found.baseline.simulator.measured) == len(learned.time)


def test_too_few_episodes_are_refused_before_anything_is_simulated(good):
    measurement = Measurement(**good).episodes(range(7))
    with pytest.raises(InvalidInput, match="in 7 episodes are too few"):
        criticise(arm()[1], measurement, np.random.default_rng(0))


def test_a_simulation_that_diverges_is_refused(good):
    wild = Measurement(**{**good, **{n: 1e12 * good[n] for n in ("qpos", "qvel")}})
    with pytest.raises(InvalidInput, match="the simulation diverges from"):
        criticise(arm()[1], wild, np.random.default_rng(0), threads=1)


def test_a_model_that_diverges_in_its_own_step_is_criticised_in_a_finer_one(good, monkeypatch):
    """And refused if it diverges in that as well."""
    diverging = {1}

    def begun(simulator, groups):
        if simulator.finer in diverging:
            raise InvalidInput(f"the simulation diverges in steps of {simulator.finer}")
        return simulator.finer, None

    monkeypatch.setattr(pipeline, "_begun", begun)
    with Simulator(arm()[1], Measurement(**good), threads=1) as simulator:
        assert pipeline._begun_in_either(simulator, []) == [(3, None)]
        diverging.add(3)
        with pytest.raises(InvalidInput, match="diverges in steps of 1"):
            pipeline._begun_in_either(simulator, [])


def test_a_remark_says_that_the_model_needs_a_smaller_step(good, monkeypatch):
    begun = pipeline._begun

    def diverging(simulator, groups):
        if simulator.finer == 1:
            raise InvalidInput("the simulation diverges")
        return begun(simulator, groups)

    monkeypatch.setattr(pipeline, "_begun", diverging)
    data = Measurement(**good).episodes(range(8))
    found = criticise(arm()[1], data, np.random.default_rng(0), threads=1)
    assert "diverges in the model's own timestep of 0.01 s" in found.verdict.remarks[0]
    assert "one of 0.00333 s" in found.verdict.remarks[0]


def test_every_fourth_episode_is_sealed(good):
    learned, sealed = split(Measurement(**good))
    assert (len(learned.spans()), len(sealed.spans())) == (23, 7)
    assert not set(map(tuple, learned.qpos)) & set(map(tuple, sealed.qpos))


def test_a_verdict_survives_an_extended_model_that_cannot_be_written(criticism):
    """Nothing is left of the forearm's mass, which MuJoCo simulates but does not write."""
    mass = float(criticism.final.simulator.base.body("fore").mass[0])
    weightless = Effect("body_mass", "body:fore", (-2 * mass,))
    final = replace(criticism.final, effects=(weightless,))
    unwritten = replace(criticism, final=final, extension=None)
    judged = extended(unwritten, arm()[1], [])
    assert judged.extension is None
    assert judged.verdict.causes == criticism.verdict.causes
    assert "MuJoCo cannot write the extended model; it says: " in judged.verdict.remarks[-1]
    assert tuple(files_of(criticism, "arm", "x")) == FILES
    assert tuple(files_of(judged, "arm", "x")) == ("verdict.json", "report.html")


def test_a_verdict_of_no_cause_is_less_sure_where_an_unknown_force_is_likely():
    """A flexible force that gains the threshold is as likely real as not."""
    assert _confidence_without(0.8, np.full(20, THRESHOLD / 20)) == pytest.approx(0.4)
    assert _confidence_without(0.8, np.zeros(20)) == pytest.approx(0.8)


@pytest.mark.slow
def test_a_cause_whose_strength_may_be_zero_is_remarked_on_and_not_named(hidden, monkeypatch):
    """Its force is left, and a flexible force finds it."""
    monkeypatch.setattr(revision, "may_be_nothing", lambda fit, slot: True)
    verdict = criticise(arm()[1], hidden, np.random.default_rng(0), threads=1).verdict
    assert (verdict.conclusion, verdict.causes) == ("unknown", ())
    (remark,) = (each for each in verdict.remarks if "may all be zero" in each)
    assert "joint_coulomb_friction joint:elbow" in remark


def test_a_verdict_is_as_sure_as_all_of_its_causes_together(refined, friction):
    def alike(*confidences):
        return tuple(Weighed((friction,), refined, np.zeros(12), each) for each in confidences)

    steps = NamedCause("sensor_quantisation", "sensor:elbow.position", (), 0.95, 50.0)
    assert _confidence_in([alike(0.6, 0.3)], []) == pytest.approx(0.9)
    assert _confidence_in([alike(0.6, 0.3), alike(0.97)], [steps]) == pytest.approx(0.82)
    assert _confidence_in([alike(0.3), alike(0.4)], []) == 0
    assert _confidence_in([alike(0.7, 0.3 + 1e-9)], []) == 1


@pytest.mark.parametrize(("strength", "is_named"), [(0.1, True), (0.3, False)])
def test_an_effect_with_which_sealed_episodes_are_predicted_worse_is_not_named(
    baseline, refined, hidden, friction, strength, is_named
):
    """The planted friction is 0.1 N m: without any the error is half of that with 0.3."""
    final = replace(refined, effects=(replace(friction, values=(strength,)),))
    named = [(Weighed(final.effects, final, np.full(12, 5.0), 0.75),)]
    outcome = _opened(
        _Outcome(named, final, 0.0, None, ()),
        baseline,
        hidden.episodes(range(12, 16)),
        threads=1,
    )
    assert bool(outcome.named) == (outcome.gain is not None) == is_named
    assert outcome.final is (final if is_named else baseline)
    assert ("joint_coulomb_friction joint:elbow" in " ".join(outcome.remarks)) != is_named
