"""The service's settings, from the environment (`ADR_…`) or the command line."""

import difflib
import os
import re
from collections.abc import Iterable, Iterator
from ipaddress import ip_network
from pathlib import Path
from typing import Any, Self

from limits import parse_many
from pydantic import (
    AliasChoices,
    Field,
    SecretStr,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, SettingsConfigDict

from adr_service.client.http import check_token
from adr_service.errors import InvalidInput
from adr_service.json_values import message_of
from api.logs import LogFormat

_SHORTEST_TOKEN = 16
_LONGEST_IDLE_S = 31_536_000.0  # a year
# variables that are no settings: of clients, of workers' and Slurm's deployments, and of tests
_OTHER_VARIABLES = {
    *("ADR_URL", "ADR_DATASETS", "ADR_WORKER_CPUS", "ADR_IMAGE", "ADR_SCRIPTS"),
    *("ADR_FAILPOINT", "ADR_KEEP", "ADR_WRITE_GOLDEN"),
}


class Settings(BaseSettings):
    """The service's data folder, address, cluster and limits."""

    model_config = SettingsConfigDict(env_prefix="ADR_", frozen=True, extra="ignore")

    data_dir: Path = Path("data")
    database_url: SecretStr = Field(
        SecretStr(""), description="of SQLite or PostgreSQL; default: a file in data_dir"
    )
    host: str = "127.0.0.1"
    port: int = Field(8000, ge=0, le=65535)
    token: SecretStr = Field(
        SecretStr(""), description="of users; needed to listen on other addresses than loopback"
    )
    robot_token: SecretStr = Field(SecretStr(""), description="of robots' clients, if not users'")
    allowed_hosts: str = Field("", description="names of the service, with commas between")
    proxies: str = Field(
        "",
        description="addresses or networks of proxies whose X-Forwarded-For and "
        "X-Forwarded-Proto are believed, with commas between",
    )
    rate: str = Field(
        "500/second", description="of requests from one address, or several with ; between"
    )
    disk_floor_mb: int = Field(500, ge=0, description="free space below which work is refused")
    retention_days: float | None = Field(
        None,
        gt=0,
        le=36_500,
        description="after which what has finished is deleted; default: never",
    )
    max_connections: int | None = Field(
        None, ge=1, le=50_000, description="at once; default: as the limit on open files allows"
    )
    max_live_runs: int = Field(10_000, ge=1, description="runs that may wait or run at once")
    ray_address: str = Field(
        "local",
        validation_alias=AliasChoices("adr_ray_address", "ray_address"),
        description="local, auto, or HOST:PORT of a cluster; or in RAY_ADDRESS",
    )
    cpus: int | None = Field(None, ge=1, description="of a local cluster; default: all")
    max_cores: int | None = Field(
        None,
        ge=1,
        le=100_000,
        description="of a cluster with an autoscaler: to ask for, and to use, at most",
    )
    resource: str = Field(
        "CPU",
        min_length=1,
        description="of the nodes for stages: Ray's name for it, one for each core",
    )
    keep_idle_s: float = Field(
        600.0,
        ge=0,
        le=_LONGEST_IDLE_S,
        description="seconds for which a process without a stage is kept",
    )
    runs_at_once: int | None = Field(
        None,
        ge=1,
        le=10_000,
        description="runs that compute; default: 64, or two for each core that is known if more",
    )
    dashboard: bool = True
    ray_dashboard_url: str = Field("", description="where browsers reach it, if not where Ray says")
    log_format: LogFormat = Field("text", description="of the log: text, or json, a line each")
    lease_s: float = Field(
        60.0, ge=1, le=3600, description="seconds until a silent robot loses its task"
    )

    @model_validator(mode="after")
    def _loopback_or_token(self) -> Self:
        if self.host not in {"127.0.0.1", "localhost", "::1"} and not self.token:
            raise ValueError(
                f"refusing to listen on {self.host!r} for everyone: set ADR_TOKEN to a secret of "
                "16 characters or more, or listen on 127.0.0.1"
            )
        for name, token in (("ADR_TOKEN", self.token), ("ADR_ROBOT_TOKEN", self.robot_token)):
            if 0 < len(token) < _SHORTEST_TOKEN:
                raise ValueError(f"{name} must have {_SHORTEST_TOKEN} characters or more")
            check_token(name, token.get_secret_value())
        if self.robot_token and self.robot_token == self.token:
            raise ValueError("ADR_ROBOT_TOKEN must not be ADR_TOKEN: robots could do everything")
        if self.robot_token and not self.token:
            raise ValueError("ADR_ROBOT_TOKEN has no effect without ADR_TOKEN: everyone has access")
        return self

    @model_validator(mode="after")
    def _known_to_a_cluster(self) -> Self:
        if self.ray_address == "local" and (self.max_cores or self.resource != "CPU"):
            raise ValueError(
                "ADR_MAX_CORES and ADR_RESOURCE are for a cluster that is joined: give its address "
                "in ADR_RAY_ADDRESS, or set ADR_CPUS for one of your own"
            )
        if self.ray_address != "local" and self.cpus is not None:
            raise ValueError(
                "ADR_CPUS is for a Ray of the service's own; one that is joined has the cores of "
                "its nodes (ADR_RAY_ADDRESS)"
            )
        return self

    @field_validator("data_dir", mode="before")
    @classmethod
    def _is_a_folder(cls, given: str | Path) -> str | Path:
        if given == "":
            raise ValueError("an empty name is no folder; for the present one, give a dot")
        return given

    @field_validator("ray_address")
    @classmethod
    def _is_an_address(cls, given: str) -> str:
        host, _, port = given.rpartition(":")
        if given in {"local", "auto"} or (host and "/" not in host and port.isdigit()):
            return given
        raise ValueError(f"{given!r} is no address; accepted are local, auto, and HOST:PORT")

    @field_validator("rate")
    @classmethod
    def _is_a_rate(cls, given: str) -> str:
        try:
            least = min(rate.amount for rate in parse_many(given))
        except ValueError:
            least = 0
        if least < 1:
            raise ValueError(
                f"{given!r} is no rate; as 500/second or 1000/minute, or several with ; between"
            )
        return given

    @field_validator("allowed_hosts")
    @classmethod
    def _are_names(cls, given: str) -> str:
        for name in given.split(","):
            if re.search(r"^[^:]*:\d+$|[\[\]/]", name.strip()):
                raise ValueError(
                    f"{name.strip()!r} is no name; give it without a port and a scheme"
                )
        return given

    @field_validator("proxies")
    @classmethod
    def _are_addresses(cls, given: str) -> str:
        for address in map(str.strip, given.split(",") if given else ()):
            try:
                ip_network(address)
            except ValueError:
                raise ValueError(
                    f"{address!r} is no address; as 127.0.0.1 or 10.0.0.0/8, or several with , "
                    "between"
                ) from None
        return given

    @field_validator("ray_dashboard_url")
    @classmethod
    def _is_a_web_address(cls, given: str) -> str:
        if given and not re.match(r"(?i:https?)://[^/]", given):
            raise ValueError(f"{given!r} is no web address; as http://127.0.0.1:8265")
        return given.rstrip("/")

    @property
    def database(self) -> str:
        if given := self.database_url.get_secret_value():
            return given
        from db.backends import url_of  # imports SQLAlchemy

        return url_of(self.data_dir.absolute() / "adr.sqlite")

    @property
    def folders(self) -> set[Path]:
        """Folders that the service writes to: of its data, and of an SQLite database.

        Raises InvalidInput if the database's URL names no database.
        """
        from db.backends import file_of, parse_url  # imports SQLAlchemy

        data_dir = self.data_dir.absolute()
        if parse_url(self.database).get_backend_name() == "postgresql":
            return {data_dir}
        return {data_dir, file_of(self.database).absolute().parent}


def read_settings(**given: Any) -> Settings:
    """Return settings from the environment; `given` ones replace those. Raises InvalidInput."""
    try:
        return Settings(**given)
    except ValidationError as error:
        raise InvalidInput(_explained(error)) from error


def unknown_variables(environment: Iterable[str]) -> Iterator[str]:
    """Yield a sentence about each `ADR_…` variable that nothing reads, with the closest known."""
    known = {f"ADR_{name.upper()}" for name in Settings.model_fields} | _OTHER_VARIABLES
    for name in sorted(environment):
        if name.upper().startswith("ADR_") and name.upper() not in known:
            close = difflib.get_close_matches(name.upper(), known, n=1)
            hint = f"; did you mean {close[0]}?" if close else ""
            yield f"{name} is no setting, and has no effect{hint}"


def too_many_cores(settings: Settings) -> Iterator[str]:
    """Yield a sentence if a local cluster is given more cores than this process may use."""
    here = len(os.sched_getaffinity(0))
    if settings.cpus is not None and settings.cpus > here:
        yield (
            f"ADR_CPUS is {settings.cpus}, but {here} cores are here: stages share them, and each "
            "takes longer"
        )


def _explained(error: ValidationError) -> str:
    """Name each invalid variable, the reason and the given value, unless that is a secret."""
    return "; ".join(
        ("" if (name := _field(e["loc"])) is None else f"ADR_{name.upper()}: ")
        + message_of(e)
        + ("" if _is_secret(name) else f" (given: {e['input']})")
        for e in error.errors()
    )


def _field(location: tuple[int | str, ...]) -> str | None:
    """The setting that an error is about; None if it is about several.

    Its location may have the variable's prefix.
    """
    return str(location[0]).removeprefix("adr_") if location else None


def _is_secret(field: str | None) -> bool:
    """True for a secret, and for all settings together, which contain secrets."""
    return field is None or Settings.model_fields[field].annotation is SecretStr
