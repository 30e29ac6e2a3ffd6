"""The baselines of criticism name what they can, where it is easy."""

import numpy as np
import pytest

from adr_service.blind_test.files import Answer, Question, write_answer
from adr_service.blind_test.planting import hide
from adr_service.effects.base import Effect
from benchmarks.baselines import nested_models, sparse_regression
from benchmarks.baselines.classifier import Classifier, Example, example, features_of
from benchmarks.baselines.comparison import answered, missing
from benchmarks.baselines.fitting import Fits, simulator_of, whole_episodes
from tests.hidden import arm

pytestmark = pytest.mark.slow
SPRING = Effect("joint_spring", "joint:elbow", (0.15,))


def question(*effects):
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(3), effects)
    return Question(nominal, data, (SPRING,))


@pytest.fixture(scope="module")
def sprung():
    return question(SPRING)


def test_system_identification_recovers_a_spring_and_its_criterion_admits_it(sprung):
    with simulator_of(sprung.nominal, sprung.measurement) as simulator:
        fits = Fits(simulator, whole_episodes)
        step = fits.step(fits.plain, SPRING)
        assert step.fall > 100
        assert step.effect.values[0] == pytest.approx(0.15, rel=0.1)
        extended = fits.fit([SPRING], fits.plain.parameters)
    assert extended is not None
    (value,) = extended.effects[0].values
    assert value == pytest.approx(0.15, abs=2 * extended.reach[0])
    assert extended.reach[0] < 0.02
    assert extended.bic() < fits.plain.bic() - 100


def test_nested_models_name_a_spring_and_nothing_where_nothing_is_hidden(sprung):
    rng = np.random.default_rng(0)
    answer = nested_models.answer(sprung, rng)
    assert answer.groups() == [[("joint_spring", "joint:elbow")]]
    assert nested_models.answer(question(), rng).verdict == "none"


def test_a_case_that_cannot_be_read_is_left_unanswered(tmp_path):
    job = ("nested models", tmp_path / "0000", tmp_path / "answer")
    assert answered(job).startswith("0000 nested models: InvalidInput: ")
    assert not (tmp_path / "answer").exists()


def test_only_questions_without_an_answer_are_missing(tmp_path):
    for name in ("0000", "0001"):
        (tmp_path / "cases" / name).mkdir(parents=True)
        (tmp_path / "cases" / name / "case.json").write_text("{}")
    write_answer(tmp_path / "ours/0000", Answer(verdict="none"))
    assert [question.name for _, question, _ in missing(tmp_path, ["ours"])] == ["0001"]


def test_sparse_regression_names_a_spring_with_its_strength(sprung):
    answer = sparse_regression.answer(sprung, np.random.default_rng(0))
    assert [(c.kind, c.location) for c in answer.causes] == [(SPRING.kind, SPRING.location)]
    stiffness = answer.causes[0].parameters["stiffness"]
    assert stiffness.low < 0.15 < stiffness.high


def test_sparse_regression_names_nothing_where_nothing_is_hidden():
    answer = sparse_regression.answer(question(), np.random.default_rng(0))
    assert answer.verdict == "none"


def test_a_classifier_names_what_its_examples_had(sprung):
    seen = features_of(sprung.nominal, sprung.measurement)
    nothing = question()
    others = [features_of(nothing.nominal, nothing.measurement), example(("arm", 4, 0)).features]
    labels = ["joint_spring joint:elbow", "nothing", "outside"]
    examples = [Example(f, n, 0.5) for f, n in zip([seen, *others], labels, strict=True)]
    learned = Classifier(examples, seed=0)
    assert learned.cpu_seconds > 1.5
    verdicts = [learned.answer(each, np.random.default_rng(0)) for each in (sprung, nothing)]
    assert verdicts[0].groups() == [[("joint_spring", "joint:elbow")]]
    assert verdicts[1].verdict == "none"
