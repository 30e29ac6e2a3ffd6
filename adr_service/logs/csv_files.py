"""Tables of text: CSV with commas, semicolons (and decimal commas) or tabs, one header line."""

import io

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.logs.arrow_tables import stream_of
from adr_service.logs.base import Log

_DELIMITERS = ("\t", ";", ",")
_COMMENT = "#"  # before a header, as NumPy writes it


def read_csv(source: str, content: bytes) -> Log:
    """The log of a table with a header. Raises InvalidInput with the line that is wrong."""
    from pyarrow import ArrowException, csv  # takes a fifth of a second

    head, _, rest = content.removeprefix(b"\xef\xbb\xbf").partition(b"\n")
    if head.startswith(_COMMENT.encode()):
        content = head.removeprefix(_COMMENT.encode()).lstrip() + b"\n" + rest
    text = head.decode("utf-8", errors="replace")
    delimiter = max(_DELIMITERS, key=text.count)
    has_commas = delimiter == ";" and b"," in rest
    try:
        table = csv.read_csv(
            io.BytesIO(content),
            parse_options=csv.ParseOptions(delimiter=delimiter),
            convert_options=csv.ConvertOptions(decimal_point="," if has_commas else "."),
        )
        names = [name.strip() for name in table.column_names]
        _check_header(source, names)
        stream, unread = stream_of(source, table.rename_columns(names))
    except (ArrowException, UnicodeDecodeError) as error:
        raise InvalidInput(f"{source} is no table that can be read: {error}") from error
    return Log(source, (stream,), unread)


def _check_header(source: str, names: list[str]) -> None:
    numbers = [name for name in names if _is_number(name)]
    if len(numbers) > len(names) / 2:
        raise InvalidInput(
            f"{source} begins with numbers ({', '.join(numbers[:3])}, …); expected are names of "
            "columns in its first line"
        )


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
