"""Formats of logs, by the ending of their names."""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, check_bytes
from adr_service.logs.csv_files import read_csv
from adr_service.logs.mcap_files import read_mcap, read_split_mcap
from adr_service.logs.npz_files import read_npz
from adr_service.logs.parquet_files import ROWS, read_lerobot, read_parquet

FORMATS: dict[str, Callable[[str, bytes], Log]] = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".npz": read_npz,
    ".parquet": read_parquet,
    ".mcap": read_mcap,
}
_BAGS = "*.mcap"
_TO_MCAP = (
    "ros2 bag convert -i BAG -o mcap.yaml, where mcap.yaml is "
    "'output_bags: [{uri: converted, storage_id: mcap, all: true}]'"
)
_CONVERTERS = {  # of bags in other forms, by the ending
    ".db3": f"a ROS 2 bag in SQLite; convert it to MCAP: {_TO_MCAP}",
    ".mcap.zstd": f"a compressed ROS 2 bag; convert it to plain MCAP: {_TO_MCAP}",
    ".bag": (
        "a ROS 1 bag; convert it to one of ROS 2 in MCAP: pip install rosbags, then "
        "rosbags-convert --src BAG --dst converted --dst-storage mcap"
    ),
}
ROWS_IN_FOLDERS = (_BAGS, ROWS)  # patterns of the files that hold rows


def read_logs(path: Path) -> list[Log]:
    """The logs of a file, of a LeRobot folder, or of a folder of bags.

    A ROS 2 bag, which is a folder with a `metadata.yaml` and its parts, is one log. Raises
    InvalidInput for other formats, for what cannot be read, and for what is too large.
    """
    if not path.exists():
        raise InvalidInput(f"{path} cannot be read: there is no such file or folder")
    if path.is_dir():
        bags = sorted(path.glob(_BAGS), key=_natural)
        if not bags:
            _check_convertible(*sorted(path.iterdir()))
            return read_lerobot(path)
        if len(bags) > 1 and (path / "metadata.yaml").is_file():
            return [read_split_mcap(path.resolve().name, _contents(bags))]
        return [log for bag in bags for log in read_logs(bag)]
    _check_convertible(path)
    if path.suffix.lower() not in FORMATS:
        raise InvalidInput(
            f"{path} ends on {path.suffix or 'nothing'!r}; accepted are {', '.join(FORMATS)}, and "
            "the folders of a LeRobot data set or of a ROS 2 bag"
        )
    return [FORMATS[path.suffix.lower()](path.name, _content(path))]


def _check_convertible(*files: Path) -> None:
    """Raises InvalidInput with the command that converts a bag of another form."""
    for file in files:
        for ending, advice in _CONVERTERS.items():
            if file.name.lower().endswith(ending):
                raise InvalidInput(f"{file} is {advice}")


def _natural(path: Path) -> list[str | int]:
    """Sort key that puts bag_2 before bag_10: the texts and the numbers of a name, in turn."""
    parts = re.split("([0-9]+)", path.name)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)]


def _contents(files: Sequence[Path]) -> Iterator[tuple[str, bytes]]:
    """Names and contents, read one at a time."""
    for file in files:
        yield file.name, _content(file)


def _content(path: Path) -> bytes:
    try:
        check_bytes(str(path), path.stat().st_size)
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{path} cannot be read: {error}") from error
