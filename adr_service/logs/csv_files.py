"""Tables of text: CSV with commas, or semicolons or tabs (and decimal commas), and a header."""

import io
import re

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.logs.arrow_tables import stream_of
from adr_service.logs.base import Log

_DELIMITERS = ("\t", ";", ",")
_SHOWN = 60  # characters of a name
_CELL = r'(?:^|[;\t\n]) *"?[+-]?\d*{}\d+(?:[eE][+-]?\d+)?"? *(?=[;\t\r\n]|$)'
_DECIMAL_COMMA = re.compile(_CELL.format(",").encode())
_DECIMAL_POINT = re.compile(_CELL.format(r"\.").encode())
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # how such texts begin
_COMMENT = b"#"  # before a header, as NumPy writes it


def read_csv(source: str, content: bytes) -> Log:
    """The log of a table with a header. Raises InvalidInput with the line that is wrong."""
    from pyarrow import ArrowException, csv  # takes a fifth of a second

    if content.startswith(_UTF_16):
        raise InvalidInput(f"{source} is in UTF-16; accepted is UTF-8, as which to save it again")
    head, rest = _header(content.removeprefix(b"\xef\xbb\xbf"))
    content = head + b"\n" + rest
    text = head.decode("utf-8", errors="replace")
    delimiter = max(_DELIMITERS, key=text.count)
    has_commas = delimiter in ";\t" and _has_decimal_commas(rest)
    try:
        table = csv.read_csv(
            io.BytesIO(content),
            parse_options=csv.ParseOptions(delimiter=delimiter),
            convert_options=csv.ConvertOptions(decimal_point="," if has_commas else "."),
        )
        names = [name.strip() for name in table.column_names]
        _check_header(source, names)
        names = [name or f"unnamed_{i}" for i, name in enumerate(names)]
        stream, unread = stream_of(source, table.rename_columns(names))
    except (ArrowException, UnicodeDecodeError) as error:
        raise InvalidInput(f"{source} is no table that can be read: {error}") from error
    return Log(source, (stream,), unread)


def _has_decimal_commas(rows: bytes) -> bool:
    """True if more numbers have decimal commas than points."""
    both = (_DECIMAL_COMMA, _DECIMAL_POINT)
    commas, points = (sum(1 for _ in each.finditer(rows)) for each in both)  # keeps none of them
    return commas > points


def _header(content: bytes) -> tuple[bytes, bytes]:
    """The header's line and the rest, without comments and blank lines before it.

    The header is itself a comment where numbers follow, as NumPy and other programs write it. Then
    it is the last comment without a number, or else the last.
    """
    comments: list[bytes] = []
    head, _, rest = content.partition(b"\n")
    while head.startswith(_COMMENT) or (rest and not head.strip()):
        if head.strip():
            comments.append(head.removeprefix(_COMMENT).lstrip())
        head, _, rest = rest.partition(b"\n")
    if not comments or not _has_numbers(head):
        return head, rest
    names = [comment for comment in comments if not _has_numbers(comment)] or comments
    return names[-1], head + b"\n" + rest


def _has_numbers(line: bytes) -> bool:
    cells = line.decode("utf-8", errors="replace").replace('"', "")
    return any(map(_is_number, re.split("[,;\t]", cells)))


def _check_header(source: str, names: list[str]) -> None:
    if len(names) == 1:
        raise InvalidInput(
            f"{source} has one column, {names[0][:_SHOWN]!r}; expected are several, separated by "
            "commas, semicolons or tabs"
        )
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
