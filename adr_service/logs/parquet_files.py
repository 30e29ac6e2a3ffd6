"""Parquet tables, and LeRobot data sets, which are folders of them.

A LeRobot data set (v2 and v3) has its rows in `data/**/*.parquet`, and names for the places of its
lists in `meta/info.json`: `observation.state` with the names `["shoulder", …]` becomes the columns
`observation.state.shoulder`, …
"""

import io
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from adr_service.errors import InvalidInput
from adr_service.logs.arrow_tables import stream_of
from adr_service.logs.base import MOST_COLUMNS, Log, Stream, check_bytes, check_size

ROWS = "data/**/*.parquet"  # of a LeRobot data set, in its folder


def read_parquet(source: str, content: bytes) -> Log:
    """The log of a Parquet table. Raises InvalidInput for damaged and for too large ones."""
    stream, unread = _stream(source, content)
    return Log(source, (stream,), unread)


def read_lerobot(folder: Path) -> list[Log]:
    """The logs of a LeRobot data set, one for each file of rows, in order."""
    files = sorted(folder.glob(ROWS))
    check_bytes(str(folder), sum(file.stat().st_size for file in files))
    if not files:
        raise InvalidInput(
            f"{folder} is neither a LeRobot data set (data/**/*.parquet) nor a ROS 2 bag (*.mcap); "
            "name the files in it instead"
        )
    names = _names_of_places(folder / "meta" / "info.json")
    logs: list[Log] = []
    numbers = 0
    for file in files:
        stream, unread = _stream(f"{folder.name}/{file.name}", file.read_bytes())
        renamed = {names.get(name, name): values for name, values in stream.columns.items()}
        if len(renamed) < len(stream.columns):
            known = Counter(names.get(name, name) for name in stream.columns)
            twice = [name for name, times in known.items() if times > 1]
            raise InvalidInput(f"{folder / 'meta' / 'info.json'} names {', '.join(twice)} twice")
        numbers += sum(map(len, renamed.values()))
        check_size(folder.name, len(renamed), numbers)
        logs.append(Log(f"{folder.name}/{file.name}", (replace(stream, columns=renamed),), unread))
    return logs


def _stream(source: str, content: bytes) -> tuple[Stream, dict[str, str]]:
    from pyarrow import ArrowException, parquet  # takes a fifth of a second

    try:
        file = parquet.ParquetFile(io.BytesIO(content))
        about = file.metadata
        check_size(source, about.num_columns, about.num_rows)
        unpacked = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
        check_bytes(f"{source}, unpacked,", unpacked)
        return stream_of(source, file.read())
    except (ArrowException, OSError, ValueError) as error:
        raise InvalidInput(f"{source} is no Parquet table that can be read: {error}") from error


def _names_of_places(file: Path) -> dict[str, str]:
    """Names of the places of lists, by the names that `columns_of` gives them."""
    try:
        about = json.loads(file.read_text(encoding="utf-8"))
        features: Mapping[str, Any] = about["features"]
        listed = {name: _names_of(feature) for name, feature in features.items()}
    except (OSError, ValueError, LookupError, AttributeError, TypeError) as error:
        raise InvalidInput(f"{file} does not describe a LeRobot data set: {error}") from error
    return {
        f"{name}_{i}": f"{name}.{place}"
        for name, places in listed.items()
        for i, place in enumerate(places[:MOST_COLUMNS])
    }


def _names_of(feature: Mapping[str, Any]) -> list[str]:
    """The names of a feature's places; none if they are not as many as these.

    They are a list, or a list in a list or under one key, such as `motors`, or keys with numbers.
    """
    names, shape = feature.get("names"), feature.get("shape")
    if isinstance(names, dict):
        keyed = cast(dict[str, Any], names)
        values = list(keyed.values())
        is_numbered = all(isinstance(value, int) for value in values)
        names = sorted(keyed, key=lambda key: keyed[key]) if is_numbered else values
    while isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
        names = names[0]
    if not isinstance(names, list) or (isinstance(shape, list) and shape != [len(names)]):
        return []
    found = cast(list[Any], names)
    return found if all(isinstance(name, str) for name in found) else []
