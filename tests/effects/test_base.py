"""Effects as values, on the wire and in domains; what a mechanism must say."""

import json
import pickle

import pytest
from pydantic import ValidationError

from adr_service.effects.base import (
    Effect,
    Friction,
    Mechanism,
    Sensing,
    Strength,
    domain_of,
    is_added,
    parse_domain,
)
from adr_service.errors import InvalidInput
from adr_service.json_values import Wire

SPRING = Effect("joint_spring", "joint:elbow", (3.0,))
WIND = Effect("wind", "global", (1.2, 0.5, -0.5))
GIVEN = {"kind": "joint_spring", "location": "joint:elbow", "values": [3.0]}


class Holder(Wire):
    effects: list[Effect]


def test_an_effect_is_a_value():
    assert Effect("joint_spring", "joint:elbow", (3.0,)) == SPRING
    assert len({SPRING, WIND, SPRING}) == 2
    assert pickle.loads(pickle.dumps(WIND)) == WIND  # noqa: S301 - our own bytes
    with pytest.raises(AttributeError):
        SPRING.kind = "wind"


def test_a_name_is_the_location_without_its_kind():
    assert SPRING.name == "elbow"
    assert WIND.name == ""
    assert Effect("sensor_bias", "sensor:elbow.position", (1.0,)).name == "elbow.position"


def test_json_of_an_effect_round_trips():
    holder = Holder(effects=[SPRING, WIND])
    assert Holder.model_validate_json(holder.model_dump_json()) == holder
    assert Holder.model_validate(holder.model_dump()) == holder
    assert json.loads(holder.model_dump_json())["effects"][0] == GIVEN
    assert Holder.model_validate({"effects": [GIVEN]}).effects == [SPRING]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": []}, "at least 1 item"),
        ({"values": [1.0] * 101}, "at most 100 items"),
        ({"values": ["1.0"]}, "valid number"),
        ({"values": [True]}, "valid number"),
        ({"values": [float("nan")]}, "finite number"),
        ({"kind": "x" * 1001}, "at most 1000 characters"),
        ({"location": 3}, "valid string"),
        ({"strength": 1.0}, "there is no field 'strength'.*accepted: kind, location, values"),
    ],
)
def test_json_that_is_no_effect_is_refused(change, message):
    with pytest.raises(ValidationError, match=message):
        Holder.model_validate({"effects": [GIVEN | change]})


def test_an_effect_without_a_place_is_refused():
    with pytest.raises(ValidationError, match="location"):
        Holder.model_validate({"effects": [{"kind": "wind", "values": [1.0]}]})


def test_a_domain_is_a_variant_and_effects():
    assert domain_of("noisy", []) == "noisy"
    assert parse_domain("noisy") == ("noisy", ())
    assert parse_domain(domain_of("noisy", [SPRING, WIND])) == ("noisy", (SPRING, WIND))


def test_the_text_of_a_domain_never_changes():
    """Stored results have digests with it."""
    text = 'vanilla@[{"kind":"joint_spring","location":"joint:elbow","values":[3.0]}]'
    assert domain_of("vanilla", [SPRING]) == text


def test_a_mechanism_acts_in_exactly_one_way():
    parts = ("rust", "joint", (Strength("depth", "m"),))
    with pytest.raises(InvalidInput, match="rust has nothing; give it exactly one of change"):
        Mechanism(*parts, typical=lambda model, joint: (1.0,))
    with pytest.raises(InvalidInput, match="rust has change and sensing"):
        Mechanism(
            *parts,
            typical=lambda model, joint: (1.0,),
            change=lambda model, joint, values: None,
            sensing=Sensing(lambda motion, values: motion.states[:, 0], record=None),
        )


def test_a_friction_is_at_a_joint():
    with pytest.raises(InvalidInput, match="rust is a friction at a body; accepted: at a joint"):
        Mechanism(
            "rust",
            "body",
            (Strength("depth", "m"),),
            typical=lambda model, body: (1.0,),
            friction=Friction(lambda state, values: values[0] * state.torques),
        )


def test_elements_that_mechanisms_add_have_names_of_their_own():
    assert is_added("adr_brake_elbow")
    assert not is_added("elbow")
