"""Commands of the recording to make next."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.motions import drawn
from adr_service.criticism.next_recording import (
    _best,
    _Comparison,
    _Squares,
    _summed,
    check_limits,
    next_recording,
    recorded_limits,
)
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.plans import read_plan
from adr_service.effects.actuators import add_passive
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.npz import read_arrays
from benchmarks.separation import held, separated
from tests.hidden import arm

LIMITS = np.array([[-1.0, 1.0], [-0.5, 0.25]])


@pytest.fixture(scope="module")
def tied():
    """An armature that the model lacks, its first recording, and the criticism, which is a tie."""
    return poorly_recorded(Effect("joint_armature", "joint:shoulder", (0.02,)))


def poorly_recorded(hidden):
    rng = np.random.default_rng(5)
    first = hide(*arm(), rng, [hidden], commands=held(rng))
    criticism = criticise(arm()[1], first, rng, threads=1)
    assert any(criticism.verdict.tied)
    return hidden, first, criticism


def planned(tied, seed=0, seconds=0.5, **settings):
    rng = np.random.default_rng(seed)
    return next_recording(tied[2], LIMITS, rng, threads=1, seconds=seconds, **settings)


@pytest.fixture(scope="module")
def near(tied):
    """A plan for the tie that keeps to the positions of its recording."""
    return planned(tied, episodes=5, seconds=1.0)


@pytest.mark.slow
def test_the_next_recording_separates_what_it_promised_to():
    """A gain of the shoulder is tied with a spring; the plan promises to tell it from that."""
    gain = Effect("actuator_gain", "actuator:shoulder", (-0.02,))
    found = separated(gain, np.random.default_rng(5))
    assert found is not None
    assert found["tied"] == "joint_spring joint:shoulder"
    assert found["is_promised"]
    assert found["is_separated"]


@pytest.mark.slow
def test_explanations_that_no_motion_separates_are_not_promised_to_be():
    """A wrong zero of the elbow's sensor does what a wrong zero of its joint does."""
    plan = planned(poorly_recorded(Effect("sensor_bias", "sensor:elbow.position", (0.02,))))
    both = {"sensor_bias sensor:elbow.position", "joint_reference_offset joint:elbow"}
    (pair,) = [s for s in plan.separations if {s.named, s.other} == both]
    assert not pair.is_expected


def test_commands_stay_within_their_limits(near):
    assert near.commands.shape == (5, round(1.0 / near.period), 2)
    low, high = near.commands.min(axis=(0, 1)), near.commands.max(axis=(0, 1))
    assert np.all(low >= LIMITS[:, 0])
    assert np.all(high <= LIMITS[:, 1])
    assert np.ptp(near.commands[..., 0]) > 1


@pytest.mark.slow
def test_a_joint_stays_within_the_positions_that_it_is_allowed(tied, near):
    far = planned(tied, allowed={0: (-1.0, 3.0), 1: (-9.0, 9.0)}, episodes=4, seconds=1.0)
    assert far.reach[0, 0] >= -1.0
    assert far.reach[0, 1] <= 3.0
    assert np.ptp(far.reach[1]) > np.ptp(near.reach[1])


def test_episodes_start_where_they_are_told_to_at_rest(tied):
    plan = planned(tied, start={1: 0.5}, episodes=3)
    assert plan.start[1] == 0.5
    simulator = tied[2].final.simulator
    commands, pose = read_plan(plan.to_npz(), 2, plan.period)
    np.testing.assert_array_equal(pose, plan.start)
    model = simulator.nominal.model(simulator.nominal.start)
    data, steps = mujoco.MjData(model), round(plan.period / model.opt.timestep)
    data.qpos[:] = pose
    for command in commands[0]:
        assert plan.reach[1, 0] - 0.2 < data.qpos[1] < plan.reach[1, 1] + 0.2
        data.ctrl[:] = command
        mujoco.mj_step(model, data, nstep=steps)


@pytest.mark.slow
def test_pieces_of_a_longer_recording_are_no_starts(clean):
    """Their first rows are in the middle of a motion, in which no robot can be put."""
    whole = Measurement(**clean)
    halves = np.arange(len(whole.time)) % 76 // 38  # of the episodes
    pieces = replace(whole, episode=2 * whole.episode + halves)
    resets, moving = (
        criticise(arm()[1], data, np.random.default_rng(0), threads=1) for data in (whole, pieces)
    )
    limits = recorded_limits(resets.final.simulator)
    rng = np.random.default_rng(0)
    assert next_recording(resets, limits, rng, threads=1, episodes=2).start is None
    plan = next_recording(moving, limits, rng, threads=1, episodes=2)
    np.testing.assert_allclose(plan.start, whole.qpos[0], atol=0.02)


def test_positions_that_no_motion_keeps_to_are_refused(tied):
    message = r"0 of them within the allowed positions \(shoulder stays there in 0\); 12 are needed"
    with pytest.raises(InvalidInput, match=message):
        planned(tied, allowed={0: (5.0, 6.0)})


@pytest.mark.slow
def test_a_plan_is_the_same_for_the_same_seed_and_a_file(tied):
    one, two, other = planned(tied), planned(tied), planned(tied, seed=1)
    np.testing.assert_array_equal(one.commands, two.commands)
    assert not np.array_equal(one.commands, other.commands)
    arrays = read_arrays(one.to_npz(), ["time", "ctrl", "episode", "qpos0"])
    np.testing.assert_array_equal(arrays["ctrl"].reshape(one.commands.shape), one.commands)
    assert len(np.unique(arrays["episode"])) == 12


def test_without_a_tie_motions_are_chosen_that_show_many_effects(nothing):
    _, criticism = nothing
    simulator = criticism.final.simulator
    limits = recorded_limits(simulator)
    np.testing.assert_array_equal(limits[:, 1], simulator.data.ctrl[simulator.starts].max(axis=0))
    plan = next_recording(criticism, limits, np.random.default_rng(0), threads=1, seconds=0.5)
    assert plan.separations == ()
    assert np.all(plan.reach[:, 0] < plan.reach[:, 1])


@pytest.mark.slow
def test_a_plan_says_what_it_could_show_that_the_recording_cannot():
    rng = np.random.default_rng(5)
    data = hide(*arm(), rng, [], commands=held(rng) * [1.0, 0.0])
    criticism = criticise(arm()[1], data, rng, threads=1)
    assert not any(criticism.verdict.tied)
    plan = next_recording(criticism, LIMITS, rng, threads=1)
    assert "actuator_gain actuator:elbow" in plan.newly_shown


@pytest.mark.parametrize(
    "limits", [np.zeros((1, 2)), np.array([[1.0, -1.0], [-1.0, 1.0]]), np.full((2, 2), np.inf)]
)
def test_wrong_limits_are_refused(tied, limits):
    with pytest.raises(InvalidInput, match="must be 2 pairs of numbers, the lower first"):
        next_recording(tied[2], limits, np.random.default_rng(0))


def test_a_model_without_actuators_has_no_plan(swinging):
    nominal, _ = swinging
    with pytest.raises(InvalidInput, match="no actuators, so that a plan has nothing to command"):
        check_limits(np.zeros((0, 2)), nominal.model(nominal.start))


def test_a_difference_that_refitting_can_absorb_is_no_evidence():
    """Least squares: of r = J x nothing is left, and of what is across J all of it."""
    rng = np.random.default_rng(0)
    design = rng.normal(size=(50, 1, 3))
    within = design[:, 0] @ np.array([1.0, -2.0, 0.5])
    across = rng.normal(size=50)
    across -= design[:, 0] @ np.linalg.lstsq(design[:, 0], across, rcond=None)[0]
    one, other = (_summed(design, rest[:, None]) for rest in (within, within + across))
    assert one.nats() == pytest.approx(0, abs=1e-5)
    assert other.nats() == pytest.approx(across @ across / 2, rel=1e-5)


@pytest.mark.slow
def test_an_actuator_that_rests_may_rest_again(tied):
    limits = np.array([[-1.0, 1.0], [0.0, 0.0]])
    rng = np.random.default_rng(0)
    plan = next_recording(tied[2], limits, rng, threads=1, seconds=0.5, episodes=3)
    np.testing.assert_array_equal(plan.commands[..., 1], 0.0)


def test_actuators_that_a_criticism_added_have_no_limits():
    nominal = arm()[1]
    spec = nominal.spec(nominal.start)
    add_passive(spec, "adr_force_elbow", "elbow", mujoco.mjtTrn.mjTRN_JOINT)
    model = spec.compile()
    assert model.nu == 3
    check_limits(np.tile([-1.0, 1.0], (2, 1)), model)
    with pytest.raises(InvalidInput, match="must be 2 pairs of numbers"):
        check_limits(np.tile([-1.0, 1.0], (3, 1)), model)


def test_every_command_of_a_motion_spreads_alike():
    limits = np.tile([-9.0, 9.0], (2, 1))
    rng = np.random.default_rng(0)
    motions = np.concatenate([drawn(limits, 20, rng) / 9 for _ in range(40)])
    spread = motions.std(axis=(0, 2))
    np.testing.assert_allclose(spread, spread.mean(), rtol=0.05)


def test_limits_beyond_what_the_actuator_obeys_are_refused(tied):
    limits = np.array([[-5.0, 5.0], [-1.0, 1.0]])
    with pytest.raises(
        InvalidInput, match="shoulder obeys commands from -1 to 1; given are limits"
    ):
        next_recording(tied[2], limits, np.random.default_rng(0))


def test_motions_that_separate_most_are_chosen_one_after_the_other():
    """Each of two pairs by its nats of four motions; the first pair is separated after one."""

    def squares(nats):
        return _Squares(np.zeros((1, 1)), np.zeros(1), 2.0 * nats)

    pair = tuple(
        _Comparison(squares(0), [squares(n) for n in nats])
        for nats in ([1, 90, 0, 50], [0, 0, 80, 0])
    )
    assert _best([pair], [0, 1, 2, 3], 3) == [1, 2, 3]
    assert _best([pair], [0, 2, 3], 1) == [2]
