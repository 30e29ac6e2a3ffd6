"""The catalogue of methods: the settings class of each is its entry."""

from typing import Annotated

from pydantic import Field

from adr_service.errors import UnknownName
from adr_service.methods.base import OfflineMethod, OnlineMethod
from adr_service.methods.bayrn import BayRnSettings
from adr_service.methods.droid import Droid, DroidSettings
from adr_service.methods.dropo import Dropo, DropoSettings
from adr_service.methods.references import OracleSettings, PriorSettings
from adr_service.methods.simopt import SimOpt, SimOpt1Settings, SimOptSettings
from adr_service.methods.sysid import Sysid, SysidSettings
from adr_service.methods.udr import UdrSettings

MethodSettings = Annotated[
    UdrSettings
    | BayRnSettings
    | SimOptSettings
    | SimOpt1Settings
    | DroidSettings
    | DropoSettings
    | SysidSettings
    | PriorSettings
    | OracleSettings,
    Field(discriminator="name"),
]
METHODS = ("udr", "bayrn", "simopt", "simopt_1", "droid", "dropo", "sysid", "prior", "oracle")
INFERRING = ("simopt", "simopt_1", "droid", "dropo", "sysid")  # one distribution, from data


def online(settings: MethodSettings) -> OnlineMethod:
    match settings:
        case SimOptSettings() | SimOpt1Settings():
            return SimOpt(settings)
        case _:
            raise UnknownName("online method", settings.name, ["simopt", "simopt_1"])


def offline(settings: MethodSettings) -> OfflineMethod:
    match settings:
        case DropoSettings():
            return Dropo(settings)
        case DroidSettings():
            return Droid(settings)
        case SysidSettings():
            return Sysid(settings)
        case _:
            raise UnknownName("offline method", settings.name, ["dropo", "droid", "sysid"])
