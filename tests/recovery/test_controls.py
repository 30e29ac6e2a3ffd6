"""What recovers planted dynamics must not recover them from actions in a wrong order.

The controls of BayesSim and NPDR, which are slow, and of SimOpt, which replays a policy and no
actions, are beside their recovery.
"""

from dataclasses import replace

import pytest

from adr_service.methods.droid import DroidSettings
from adr_service.methods.dropo import DropoSettings, EDropoSettings
from adr_service.methods.sysid import SysidLaplaceSettings, SysidSettings, SysidWideSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PROBLEM, distance, recorded, waving_policy

OFFLINE = (
    SysidSettings(),
    SysidWideSettings(),
    SysidLaplaceSettings(),
    DropoSettings(epsilon=2e-5),
    EDropoSettings(epsilon=1e-4),
    DroidSettings(budget=600),
)
RECORDED = recorded(waving_policy(), noise=0.003)
DISORDERED = replace(RECORDED, actions=RECORDED.actions[::-1])


@pytest.mark.parametrize("settings", OFFLINE, ids=lambda settings: settings.name)
def test_offline_methods_need_the_actions_in_their_order(settings):
    def error(data):
        estimate = settings.create().fit(PROBLEM, data, stream("control"), silent)
        return distance(estimate.distribution.mean)

    assert error(RECORDED) < 0.05
    assert error(DISORDERED) > 0.25
