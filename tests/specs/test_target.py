import pytest
from pydantic import ValidationError

from adr_service.specs import EXTERNAL_EPISODES, RunSpec

GOOD = {"task": "arm", "method": "sysid", "preset": "smoke"}
FRICTION = {"kind": "joint_coulomb_friction", "location": "joint:elbow", "values": [0.5]}


def target(**fields):
    return RunSpec.model_validate({**GOOD, "target": fields})


def test_a_simulated_target_is_the_default_and_its_effects_are_part_of_the_domain():
    assert RunSpec.model_validate(GOOD).target.kind == "simulated"
    spec = target(kind="simulated", effects=[FRICTION])
    assert spec.source_domain == "vanilla"
    assert spec.target_domain.startswith("vanilla@")
    assert "joint_coulomb_friction" in spec.target_domain


def test_an_extension_is_part_of_the_source_and_not_of_the_target():
    spec = RunSpec.model_validate({**GOOD, "extension": [FRICTION]})
    assert spec.target_domain == "vanilla"
    assert spec.source_domain.startswith("vanilla@")


def test_a_robots_final_evaluation_is_short_unless_more_is_asked_for():
    assert target(kind="external").evaluation_episodes == EXTERNAL_EPISODES
    asked = {**GOOD, "target": {"kind": "external"}, "evaluation_episodes": 9}
    assert RunSpec.model_validate(asked).evaluation_episodes == 9


def test_a_recorded_target_is_its_own_collector_and_names_its_program():
    spec = target(kind="recorded", dataset="data_1")
    assert (spec.collector, spec.dataset) == ("recording", "data_1")
    assert spec.program == "adr_service.programs.recorded"
    assert RunSpec.model_validate(GOOD).program == "adr_service.programs.offline"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"method": "simopt", "target": {"kind": "recorded", "dataset": "d"}},
            "serves bayes_sim, droid",
        ),
        ({"target": {"kind": "recorded", "dataset": "d", "episodes": 0}}, "greater than or equal"),
        ({"collector": "recording"}, "goes with a recorded one"),
        ({"target": {"kind": "imagined"}}, "one of simulated, recorded, external"),
        ({"extension": [{**FRICTION, "location": "joint:wrist"}]}, "there is no place"),
        ({"extension": [FRICTION, FRICTION]}, "is given twice"),
        ({"extension": [{**FRICTION, "values": [-1.0]}]}, "0 at least"),
        ({"extension": [{**FRICTION, "values": []}]}, "at least 1"),
        ({"target": {"kind": "simulated", "effects": [{**FRICTION, "kind": "rust"}]}}, "'rust'"),
    ],
    ids=str,
)
def test_a_target_that_cannot_be_is_refused_with_what_can(change, message):
    with pytest.raises(ValidationError, match=message):
        RunSpec.model_validate({**GOOD, **change})
