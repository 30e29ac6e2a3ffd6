"""A measurement from logs to files, without a service."""

from collections.abc import Sequence
from pathlib import Path

from adr_service.criticism.compatibility import check_measurement, check_state
from adr_service.criticism.excitation import excitation
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.errors import InvalidInput
from adr_service.json_values import encodable
from adr_service.logs.base import Log
from adr_service.logs.catalogue import read_logs
from adr_service.logs.conversion import Converted, convert
from adr_service.logs.drafting import draft
from adr_service.logs.mapping import LogMap
from adr_service.logs.report import report_page
from adr_service.whole_files import written_whole
from api.cli.criticism_files import check_differ, nominal_of
from api.cli.files import naming, read_text


def draft_of(logs: Sequence[Path], task: str | None, model: Path | None) -> str:
    """A map to start from, in TOML."""
    nominal, _ = nominal_of(task, None, model, ())
    robot = nominal.model(nominal.start)
    check_state(robot)
    return draft(_read(logs), robot)


def measure_files(
    logs: Sequence[Path], task: str | None, model: Path | None, map: Path, out: Path
) -> Converted:
    """Write the measurement, and a page about it beside it.

    Raises InvalidInput for what cannot be measured, and for more than a criticism takes.
    """
    nominal, name = nominal_of(task, None, model, ())
    robot = nominal.model(nominal.start)
    text = read_text(map)
    with naming(map):
        columns = LogMap.from_toml(text)
    converted = convert(_read(logs), columns, robot)
    _check_rows(nominal, converted)
    with written_whole(out) as part:
        part.write_bytes(converted.measurement.to_npz())
    page = _page(converted, nominal, ", ".join(log.name for log in logs), name)
    with written_whole(out.with_suffix(".html")) as part:
        part.write_bytes(encodable(page).encode())  # names of files may be no UTF-8
    return converted


def _check_rows(nominal: Nominal, converted: Converted) -> None:
    """Raises InvalidInput for rows that `adr criticise` refuses: too many, or too far apart."""
    try:
        check_measurement(nominal, converted.measurement)
    except InvalidInput as error:
        raise InvalidInput(
            f"{error}. rows.period of the map says how far rows are apart, here "
            f"{converted.period:g} s, and rows.seconds how long an episode is"
        ) from error


def _read(logs: Sequence[Path]) -> list[Log]:
    check_differ(logs)
    return [log for path in logs for log in read_logs(path)]


def _page(converted: Converted, nominal: Nominal, logs: str, name: str) -> str:
    with Simulator(nominal, converted.measurement) as simulator:
        shown = excitation(simulator, converted.noise)
        return report_page(converted, shown, simulator.base, f"{logs}, for {name}")
