"""Cases of a blind test."""

import numpy as np
import pytest

from adr_service.blind_test.cases import Hidden
from adr_service.blind_test.planting import Case, draw_case
from adr_service.effects.base import Effect
from tests.hidden import arm

BIAS = Effect("actuator_bias", "actuator:shoulder", (-0.12,))


@pytest.fixture(scope="session")
def case() -> Case:
    """A case of the arm that hides one effect."""
    return draw_case(*arm(), np.random.default_rng(5), ratio=0.3)


def hidden(kind="one", ratio=0.3, effects=(BIAS,), outside=None):
    return Hidden(task="arm", kind=kind, ratio=ratio, effects=effects, outside=outside)
