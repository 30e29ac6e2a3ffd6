"""Effects are drawn as strong as asked for, possible, and such that a method can name them."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.outside import OUTSIDE
from adr_service.blind_test.planting import hide
from adr_service.blind_test.sizing import Sizing, noise_of
from adr_service.criticism.nominal import Nominal
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.tasks.catalogue import get_task, source_of
from tests.hidden import arm


@pytest.fixture(scope="module")
def motions():
    return hide(*arm(), np.random.default_rng(0), []).episodes(range(8))


@pytest.fixture(scope="module")
def sizing(motions):
    return Sizing(arm()[1], motions)


def drawn(sizing, kinds, count=8, ratio=0.3):
    rng = np.random.default_rng(3)
    return [sizing.draw_effect(rng, ratio, kinds) for _ in range(count)]


def test_a_ripple_is_sized_by_its_amplitudes_and_keeps_its_waves(sizing):
    kind = "joint_torque_ripple"
    (weak,), (strong,) = (drawn(sizing, [kind], 1, ratio) for ratio in (0.1, 0.3))
    assert weak.kind == strong.kind == kind
    assert 8 <= weak.values[2] == strong.values[2] <= 24
    np.testing.assert_allclose(np.divide(strong.values, weak.values)[:2], 3.0, rtol=0.15)


def test_a_friction_is_nowhere_negative(sizing):
    frictions = drawn(sizing, ["joint_position_dependent_friction"])
    mean, sine, cosine, waves = np.transpose([effect.values for effect in frictions])
    assert np.all(np.hypot(sine, cosine) < 1.01 * mean)
    assert np.all((waves >= 8) & (waves <= 24))


@pytest.mark.parametrize("kind", ["joint_quadratic_friction", "joint_cubic_spring"])
def test_what_grows_with_motion_does_not_drive_its_joint(sizing, kind):
    assert all(effect.values[0] > 0 for effect in drawn(sizing, [kind]))


def test_nothing_is_hidden_that_more_than_two_others_equal(sizing):
    """The shoulder feels its link's payload, mass and inertia, and its own rotor, as one."""
    assert {effect.location for effect in drawn(sizing, ["payload"])} == {"body:fore"}


@pytest.mark.parametrize(
    ("effect", "kind", "place", "equal"),
    [
        (
            Effect("joint_reference_offset", "joint:elbow", (0.01,)),
            *("sensor_bias", "sensor:elbow.position", True),
        ),
        (
            Effect("joint_coulomb_friction", "joint:elbow", (0.1,)),
            *("joint_viscous_friction", "joint:elbow", False),
        ),
        # beside a free mass with its inertia; and a payload cannot be negative
        (Effect("body_mass", "body:upper", (-0.3,)), "payload", "body:upper", True),
        (Effect("body_mass", "body:upper", (0.3,)), "payload", "body:upper", False),
    ],
)
def test_effects_are_equal_if_they_change_the_same(sizing, effect, kind, place, equal):
    assert sizing.are_equal(effect, kind, place) is equal


def test_a_force_outside_the_catalogue_is_as_strong_as_an_effect(sizing, motions):
    """It does as much as a constant torque of the same root mean square, but for a coupling, of
    which free masses explain a part: links that are driven move others too."""
    rng = np.random.default_rng(3)
    forces = [sizing.draw_force(rng, 0.3) for _ in range(30)]
    assert {force.kind for force in forces} == set(OUTSIDE)
    biases = {b.location: abs(b.values[0]) for b in drawn(sizing, ["actuator_bias"])}
    along = np.linspace(0, 1, len(motions.time), endpoint=False)
    for force in forces:
        per_newton = {
            "cross_coupling": motions.ctrl[:, force.other],
            "gain_drift": motions.ctrl[:, force.actuator] * (along - 0.5),
            "disturbance": np.full(1, np.sqrt(0.5)),
        }
        torque = force.size * np.sqrt(np.mean(per_newton[force.kind] ** 2))
        place = f"actuator:{['shoulder', 'elbow'][force.dof]}"
        if force.kind == "cross_coupling":
            assert torque > 1.1 * biases[place]
        else:
            assert torque == pytest.approx(biases[place], rel=0.05)


def test_a_force_that_changes_nothing_is_refused(motions):
    still = Sizing(arm()[1], replace(motions, ctrl=np.zeros_like(motions.ctrl)))
    changing = (still.draw_force(np.random.default_rng(seed), 0.3).kind for seed in range(20))
    with pytest.raises(InvalidInput, match=r"a (gain_drift|cross_coupling) .* changes nothing"):
        list(changing)


@pytest.mark.slow
def test_a_gap_that_shows_is_wider_than_its_encoder_is_noisy():
    """Feet on the ground make much of small errors, those of the readings among them."""
    task = get_task("half_cheetah")
    nominal = Nominal.of_task(task, source_of("half_cheetah", "vanilla"))
    motions = hide(task, nominal, np.random.default_rng(0), []).episodes(range(3))
    (gap,) = drawn(Sizing(nominal, motions), ["joint_backlash"], 1, ratio=1.0)
    assert gap.values[0] > 4 * noise_of(nominal.model(nominal.start))[0]


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("contact_friction", r"200 draws of .* no effect of ratio 0.3"),  # the arm touches nothing
        ("contact_frictions", "did you mean 'contact_friction'"),
    ],
)
def test_kinds_that_cannot_be_as_strong_are_refused(sizing, kind, message):
    with pytest.raises(InvalidInput, match=message):
        drawn(sizing, [kind])
