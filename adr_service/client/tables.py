"""Answers of the service that are tables."""

from typing import TYPE_CHECKING, Any, Literal, get_args

from adr_service.errors import UnknownName

if TYPE_CHECKING:
    import pandas

Json = dict[str, Any]
Table = Literal["rows", "aggregates", "comparisons", "estimates", "costs"]


class Rows(list[Json]):
    """A list of JSON objects: a row each."""

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a frame; fields of nested objects are columns as `spec.task`."""
        import pandas  # takes a moment

        return pandas.json_normalize(self)


class Results(Json):
    """The results of a run or a benchmark."""

    def to_pandas(
        self,
        table: Table = "rows",
    ) -> "pandas.DataFrame":
        """Return one of the tables as a frame.

        rows: the return of each method on each task after each iteration, with its interval.
        aggregates: each method over all its tasks.
        comparisons: the probability that one method beats another.
        estimates: mean and standard deviation of each parameter, by seed and iteration.
        costs: simulated steps and seconds of inference.

        Raises UnknownName for another table.
        """
        if table not in get_args(Table):
            raise UnknownName("table", table, get_args(Table))
        return Rows(self[table]).to_pandas()
