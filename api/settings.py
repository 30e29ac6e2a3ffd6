"""The service's settings, from the environment (`ADR_…`) or the command line."""

from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from adr_service.errors import InvalidInput
from adr_service.wire import explain

DEFAULT_URL = "http://127.0.0.1:8000"


class Settings(BaseSettings):
    """Where the service keeps its data, listens, and computes."""

    model_config = SettingsConfigDict(env_prefix="ADR_", frozen=True, extra="ignore")

    data_dir: Path = Path("data")
    database_url: str = Field("", description="an SQLite file; default: in data_dir")
    host: str = "127.0.0.1"
    port: int = Field(8000, ge=0, le=65535)
    token: str = Field("", description="needed to listen on other addresses than loopback")
    ray_address: str = Field("local", description="local, auto, or the address of a cluster")
    cpus: int | None = Field(None, ge=1, description="of a local cluster; default: all")
    dashboard: bool = True
    lease_s: float = Field(60.0, ge=1, le=3600, description="of a robot that shows no life")

    @model_validator(mode="after")
    def _loopback_or_token(self) -> Self:
        if self.host not in {"127.0.0.1", "localhost", "::1"} and len(self.token) < 16:
            raise ValueError(
                f"refusing to listen on {self.host!r} for everyone: set ADR_TOKEN to a secret of "
                "16 characters or more, or listen on 127.0.0.1"
            )
        return self

    @property
    def database(self) -> str:
        return self.database_url or f"sqlite:///{self.data_dir.absolute() / 'adr.sqlite'}"


def read_settings(**given: Any) -> Settings:
    """Settings from the environment, and what is given here over it."""
    try:
        return Settings(**given)
    except ValidationError as error:
        raise InvalidInput(explain(error, "settings")) from error
