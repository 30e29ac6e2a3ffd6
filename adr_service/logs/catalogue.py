"""Formats of logs, by the ending of their names."""

from collections.abc import Callable
from pathlib import Path

from adr_service.errors import InvalidInput
from adr_service.logs.base import MOST_BYTES, Log
from adr_service.logs.csv_files import read_csv
from adr_service.logs.mcap_files import read_mcap
from adr_service.logs.npz_files import read_npz
from adr_service.logs.parquet_files import read_lerobot, read_parquet

FORMATS: dict[str, Callable[[str, bytes], Log]] = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".npz": read_npz,
    ".parquet": read_parquet,
    ".mcap": read_mcap,
}


def read_logs(path: Path) -> list[Log]:
    """The logs of a file, or of a LeRobot folder. Raises InvalidInput for other formats, for what
    cannot be read, and for what is too large."""
    if path.is_dir():
        bags = sorted(path.glob("*.mcap"))  # a ROS 2 bag is a folder with its parts
        if bags:
            return [log for bag in bags for log in read_logs(bag)]
        return read_lerobot(path)
    if path.suffix.lower() not in FORMATS:
        raise InvalidInput(
            f"{path} ends on {path.suffix or 'nothing'!r}; accepted are {', '.join(FORMATS)}, and "
            "the folders of a LeRobot data set or of a ROS 2 bag"
        )
    try:
        if (size := path.stat().st_size) > MOST_BYTES:
            raise InvalidInput(f"{path} has {size:,} bytes; accepted are {MOST_BYTES:,}")
        content = path.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{path} cannot be read: {error}") from error
    return [FORMATS[path.suffix.lower()](path.name, content)]
