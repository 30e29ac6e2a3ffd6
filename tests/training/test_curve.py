"""Points of a learning curve."""

import pytest
from pydantic import ValidationError

from adr_service.training.curve import Evaluation


def test_json_gives_the_same_point_back():
    point = Evaluation(steps=300, mean_return=1.5, standard_error=0.25)
    assert Evaluation.model_validate_json(point.model_dump_json()) == point


def test_a_return_that_is_not_finite_is_refused():
    with pytest.raises(ValidationError, match="finite"):
        Evaluation(steps=300, mean_return=float("nan"), standard_error=0.25)
