"""Settings of runs that differ from their presets."""

from adr_service.benchmark import budgets
from adr_service.specs import RunSpec
from tests.benchmark.test_claims import outcome


def test_all_settings_are_named_where_the_preset_itself_is_not_possible(monkeypatch):
    """As with more transitions than an episode of a user's task has: it made pages fail."""
    monkeypatch.setattr(budgets, "_usual", lambda *_: RunSpec.model_validate({}))
    named = budgets.changes([outcome(1.0)])
    assert named.items() >= {"iterations": 2, "simopt.kl_threshold": 1.0}.items()
