"""The catalogue of methods: the settings class of each is its entry."""

from typing import Annotated

from pydantic import Field

from adr_service.errors import UnknownName
from adr_service.methods.base import OfflineMethod, OnlineMethod
from adr_service.methods.dropo import Dropo, DropoSettings
from adr_service.methods.references import OracleSettings, PriorSettings
from adr_service.methods.simopt import SimOpt, SimOptSettings
from adr_service.methods.udr import UdrSettings

MethodSettings = Annotated[
    UdrSettings | SimOptSettings | DropoSettings | PriorSettings | OracleSettings,
    Field(discriminator="name"),
]
METHODS = ("udr", "simopt", "dropo", "prior", "oracle")


def online(settings: MethodSettings) -> OnlineMethod:
    match settings:
        case SimOptSettings():
            return SimOpt(settings)
        case _:
            raise UnknownName("online method", settings.name, ["simopt"])


def offline(settings: MethodSettings) -> OfflineMethod:
    match settings:
        case DropoSettings():
            return Dropo(settings)
        case _:
            raise UnknownName("offline method", settings.name, ["dropo"])
