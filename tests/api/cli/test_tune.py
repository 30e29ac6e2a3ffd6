"""Refusals of `adr tune` before anything starts."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("arm", "--over", "learning_rate=fast"), "--over needs name=[value,…] with JSON values"),
        (("arm", "--over", "learning_rate=[]"), "given 'learning_rate=[]'"),
        (("arm", "--over", "learning_rate=[0.1,0]"), "{'learning_rate': 0}: training"),
        (("arm", "--over", "epoch=[1]"), "did you mean 'epochs'"),
        (("arm", "--over", "epochs=[1]", "--over", "epochs=[2]"), "--over has one setting twice"),
        (("arm", "--over", "epochs=[1]", "--set", "seed=5"), "takes --first-seed, not --set seed"),
        (("arm", "--over", "epochs=[1]", "--set", "training=null"), "training: give training"),
        (("arm", "--over", "epochs=[1]", "--set", "training.epochs=5"), "given, and searched"),
        (("arm", "--over", "epochs=[1]", "--first-seed", str(2**31 - 1)), "seed: Input should be"),
        (("arm", "--over", "epochs=[1]", "--cpus", "0"), "Invalid value for '--cpus'"),
        (("arm", "--over", "epochs=[1]", "--set", "preset=quick"), "takes --preset, not --set"),
        (("amr", "--over", "epochs=[1]"), "task: there is no task 'amr'"),
    ],
)
def test_settings_that_cannot_be_tried_are_refused(adr_here, arguments, message):
    code, _, errors = adr_here("tune", *arguments)
    assert code == 2
    assert message in errors.replace("\n", " ")
