"""Recordings of a target: transitions of episodes, read-only and finite.

    data = TransitionDataset.from_npz(path.read_bytes())
    starts = data.windows(1)        # first rows of windows of one step

The `.npz` keys are DROPO's (`observations`, `next_observations`, `actions`, `terminals`), and `dt`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adr_service.arrays import Indices, Matrix, frozen, spans
from adr_service.errors import InvalidInput
from adr_service.json_values import is_a_line, sha256
from adr_service.npz import read_arrays, write_arrays

MOST_EPISODES = 100_000
MOST_COLUMNS = 1_000  # of observations, and of actions
_LONGEST_NAME = 200  # characters of a column's name
_LONGEST_ORIGIN = 10_000  # characters
_NEEDED = ("observations", "actions", "next_observations", "dt")
UNKNOWN_ORIGIN = "unknown"
_OPTIONAL = ("episodes", "terminals", "columns", "origin")


@dataclass(frozen=True)
class TransitionDataset:
    """N transitions in recording order; rows of one episode are consecutive."""

    observations: Matrix  # (N, s)
    actions: Matrix  # (N, a)
    next_observations: Matrix  # (N, s)
    episodes: Indices  # (N,) non-decreasing episode ids
    dt: float  # control period [s]
    columns: tuple[str, ...]  # observation columns with their units, "thigh_angle [rad]"
    origin: str  # source of the data, in words

    ARRAYS = (*_NEEDED, *_OPTIONAL)  # of an `.npz`, by name

    def __post_init__(self) -> None:
        for name in ("observations", "actions", "next_observations"):
            object.__setattr__(self, name, _finite_matrix(name, getattr(self, name)))
        object.__setattr__(self, "episodes", _ids(np.asarray(self.episodes)))
        self._check_rows()
        self._check_episodes()
        self._check_names()
        if not 0 < self.dt < np.inf:
            raise InvalidInput(f"the control period must be positive; given {self.dt} s")

    def _check_rows(self) -> None:
        arrays = (self.observations, self.actions, self.next_observations, self.episodes)
        rows = {len(array) for array in arrays}
        if len(rows) != 1 or self.observations.shape != self.next_observations.shape:
            raise InvalidInput(
                f"arrays must have one row per transition; given observations "
                f"{self.observations.shape}, actions {self.actions.shape}, next_observations "
                f"{self.next_observations.shape}, episodes {self.episodes.shape}"
            )

    def _check_episodes(self) -> None:
        if not len(self.episodes):
            raise InvalidInput("a recording has at least one transition; this has none")
        if np.any(self.episodes[1:] < self.episodes[:-1]):
            raise InvalidInput("episode ids must not decrease from row to row")
        if self.episode_count > MOST_EPISODES:
            raise InvalidInput(
                f"a recording has {MOST_EPISODES:,} episodes at most; this has "
                f"{self.episode_count:,}"
            )

    def _check_names(self) -> None:
        """Raise InvalidInput for what no file could give back."""
        if len(self.columns) != self.observations.shape[1]:
            raise InvalidInput(
                f"{len(self.columns)} column names for {self.observations.shape[1]} columns"
            )
        named = [("columns", text, _LONGEST_NAME) for text in self.columns]
        for name, text, longest in (*named, ("origin", self.origin, _LONGEST_ORIGIN)):
            if len(text) > longest:
                raise InvalidInput(
                    f"{name} has a text of {len(text)} characters; accepted are {longest}"
                )
            if not is_a_line(text):
                shown = repr(text[:_LONGEST_NAME])
                raise InvalidInput(f"{name} has ends of lines or control characters: {shown}")

    def __len__(self) -> int:
        return len(self.observations)

    def __repr__(self) -> str:
        s, a = self.observations.shape[1], self.actions.shape[1]
        counts = f"{len(self)} transitions, {self.episode_count} episodes"
        return f"TransitionDataset({counts}, s={s}, a={a})"

    @property
    def episode_count(self) -> int:
        return 1 + int(np.count_nonzero(np.diff(self.episodes)))

    def windows(self, length: int) -> Indices:
        """First rows (k,) of consecutive, disjoint windows, each of `length` rows in an episode."""
        starts = [
            row
            for first, last in spans(self.episodes)
            for row in range(first, last - length + 1, length)
        ]
        return np.array(starts, dtype=np.int64)

    def check_chained(self, purpose: str) -> None:
        """Raise InvalidInput unless each next observation is the observation of the next row.

        The message names the purpose that needs it: "smoothing".
        """
        for episode in self.split():
            differ = np.any(episode.next_observations[:-1] != episode.observations[1:], axis=1)
            if differ.any():
                row = int(np.argmax(differ))
                raise InvalidInput(
                    f"{purpose} needs each next observation to be the observation of the row "
                    f"after; in episode {int(episode.episodes[0])}, rows {row} and {row + 1} "
                    "differ (next observations may have noise of their own)"
                )

    def split(self) -> list["TransitionDataset"]:
        """One dataset per episode, in order."""
        return [self._rows(slice(first, last)) for first, last in spans(self.episodes)]

    def first_episodes(self, count: int) -> "TransitionDataset":
        """The first `count` (at least one) episodes, or all if there are fewer."""
        return self.first(spans(self.episodes)[:count][-1][1])

    def first(self, rows: int) -> "TransitionDataset":
        """The first `rows` (at least one) transitions, or all if there are fewer."""
        if rows < 1:
            raise InvalidInput(f"rows must be at least 1; given {rows}")
        return self._rows(slice(rows))

    def to_npz(self) -> bytes:
        """Bytes for `from_npz`; the same data always gives the same bytes."""
        return write_arrays(self.to_arrays())

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The arrays of an `.npz`, by name."""
        return {
            "observations": self.observations,
            "actions": self.actions,
            "next_observations": self.next_observations,
            "terminals": np.append(np.diff(self.episodes) > 0, True),
            "episodes": self.episodes,
            "dt": np.array(self.dt, dtype=np.float64),
            "columns": np.array(self.columns),
            "origin": np.array(self.origin),
        }

    @classmethod
    def from_npz(cls, content: bytes) -> "TransitionDataset":
        """The data in an `.npz`; without `episodes`, `terminals` mark the ends of episodes."""
        return cls.from_arrays(read_arrays(content, cls.ARRAYS))

    @classmethod
    def from_arrays(cls, fields: Mapping[str, np.ndarray]) -> "TransitionDataset":
        """The data in the arrays of an `.npz`, by name."""
        _check_fields(fields)
        width = fields["observations"].shape[-1] if fields["observations"].ndim else 0
        return cls(
            observations=fields["observations"],
            actions=fields["actions"],
            next_observations=fields["next_observations"],
            episodes=_episodes(fields),
            dt=float(fields["dt"]),
            columns=tuple(np.atleast_1d(fields.get("columns", unnamed(width))).tolist()),
            origin=str(fields.get("origin", UNKNOWN_ORIGIN)),
        )

    @classmethod
    def from_npy(
        cls, prefix: Path, *, dt: float, columns: Sequence[str], origin: str
    ) -> "TransitionDataset":
        """The data in DROPO's own files, PREFIX_observations.npy and so on.

        For files in a trusted folder; `from_npz` is for uploads.
        """
        names = ("observations", "actions", "nextobservations", "terminals")
        try:
            arrays = {n: np.load(f"{prefix}_{n}.npy", allow_pickle=False) for n in names}
        except (OSError, ValueError, EOFError) as error:
            raise InvalidInput(f"{prefix}_*.npy cannot be read: {error}") from error
        return cls(
            observations=arrays["observations"],
            actions=arrays["actions"],
            next_observations=arrays["nextobservations"],
            episodes=_episodes(arrays),
            dt=dt,
            columns=tuple(columns),
            origin=origin,
        )

    @classmethod
    def concatenate(cls, parts: Sequence["TransitionDataset"]) -> "TransitionDataset":
        """The parts one after the other; episodes are renumbered so that none merge.

        The period and the names of columns are the first part's. Raises InvalidInput unless all
        have the same; parts without names go with all others.
        """
        if not parts:
            raise InvalidInput("at least one part is needed to concatenate; given none")
        _check_alike(parts)
        offset, episodes = 0, []
        for part in parts:
            _, ids = np.unique(part.episodes, return_inverse=True)
            episodes.append(ids + offset)
            offset += int(ids[-1]) + 1
        return cls(
            observations=np.concatenate([p.observations for p in parts]),
            actions=np.concatenate([p.actions for p in parts]),
            next_observations=np.concatenate([p.next_observations for p in parts]),
            episodes=np.concatenate(episodes),
            dt=parts[0].dt,
            columns=parts[0].columns,
            origin=_cut("; ".join(dict.fromkeys(p.origin for p in parts))),
        )

    def _rows(self, rows: slice) -> "TransitionDataset":
        return TransitionDataset(
            self.observations[rows],
            self.actions[rows],
            self.next_observations[rows],
            self.episodes[rows],
            self.dt,
            self.columns,
            self.origin,
        )


def dataset_id(content: bytes) -> str:
    """The name of a stored recording, made from the hash of its bytes."""
    return f"data_{sha256(content)[:16]}"


def unnamed(width: int) -> np.ndarray:
    """The column names of data without names, (width,)."""
    return np.array([f"observation_{i}" for i in range(width)], dtype=str)


def _check_alike(parts: Sequence[TransitionDataset]) -> None:
    """Raise InvalidInput unless all parts have one period, one width and the same columns."""
    first, width = parts[0], _width(parts[0])
    nameless = tuple(unnamed(width[0]).tolist())
    named = next((n for n, part in enumerate(parts) if part.columns != nameless), 0)
    for number, part in enumerate(parts, 1):
        # twice what `check_recorded` allows each part
        if not np.isclose(part.dt, first.dt, rtol=2e-6, atol=2e-8):
            raise InvalidInput(
                f"joined parts must have one control period; part 1 has {first.dt} s, part "
                f"{number} {part.dt} s"
            )
        if (given := _width(part)) != width:
            raise InvalidInput(
                f"joined parts must be equally wide; part 1 has {width[0]} observations and "
                f"{width[1]} actions, part {number} {given[0]} and {given[1]}"
            )
        if part.columns not in (parts[named].columns, nameless):
            raise InvalidInput(
                f"joined parts must have the same columns; part {named + 1} has "
                f"{', '.join(parts[named].columns)}, part {number} {', '.join(part.columns)}"
            )


def _width(data: TransitionDataset) -> tuple[int, int]:
    """The numbers of observation columns and of actions."""
    return data.observations.shape[1], data.actions.shape[1]


def _cut(origin: str) -> str:
    """An origin that can be read back."""
    end = " …"
    is_short = len(origin) <= _LONGEST_ORIGIN
    return origin if is_short else origin[: _LONGEST_ORIGIN - len(end)] + end


def _ids(given: np.ndarray) -> Indices:
    """Episode ids as they are kept, read-only."""
    if not _are_ids(given):
        raise InvalidInput(f"episodes must be integers below 2**63; given {given.dtype} {given}")
    ids = np.array(given, dtype=np.int64)
    ids.flags.writeable = False
    return ids


def _are_ids(given: np.ndarray) -> bool:
    """True for integers below 2**63, of any type; there may be millions."""
    if given.dtype.kind == "f":
        return bool(np.all((given == np.floor(given)) & (np.abs(given) < 2.0**63)))
    return given.dtype.kind in "bi" or (given.dtype.kind == "u" and given.max(initial=0) < 2**63)


def _finite_matrix(name: str, values: np.ndarray) -> Matrix:
    values = np.asarray(values)
    if values.dtype.kind not in "iuf":
        raise InvalidInput(f"{name} must hold numbers; given {values.dtype}")
    matrix = frozen(values)
    if matrix.ndim != 2:
        raise InvalidInput(f"{name} must be a matrix; its shape is {matrix.shape}")
    if not 0 < matrix.shape[1] <= MOST_COLUMNS:
        raise InvalidInput(
            f"{name} has the shape {matrix.shape}; accepted are 1 to {MOST_COLUMNS} columns"
        )
    if not np.all(np.isfinite(matrix)):
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        raise InvalidInput(f"{name} is not finite at row {row}, column {column}")
    return matrix


def _check_fields(fields: Mapping[str, np.ndarray]) -> None:
    """Raise InvalidInput if an array of an `.npz` is missing or of the wrong kind."""
    missing = [name for name in _NEEDED if name not in fields]
    if not fields.keys() & {"episodes", "terminals"}:
        missing.append("episodes (or terminals)")
    if missing:
        raise InvalidInput(f"the .npz lacks {missing}; it has {sorted(fields)}")
    if (dt := fields["dt"]).dtype.kind not in "iuf" or dt.ndim != 0:
        raise InvalidInput(f"dt must be one number; given {dt.dtype} {dt.shape}")
    _check_texts(fields, "columns", 1)
    _check_texts(fields, "origin", 0)


def _check_texts(fields: Mapping[str, np.ndarray], name: str, dimensions: int) -> None:
    """Raise InvalidInput unless an optional array holds texts."""
    texts = fields.get(name, np.array(""))
    if texts.ndim > dimensions or (texts.size and texts.dtype.kind != "U"):
        raise InvalidInput(
            f"{name} must be {'one text' if dimensions == 0 else 'a list of texts'}; given "
            f"{texts.dtype} {texts.shape}"
        )


def _episodes(fields: Mapping[str, np.ndarray]) -> np.ndarray:
    """Episode ids (N,), from `episodes` or from the ends that `terminals` mark."""
    ids, terminals = fields.get("episodes"), fields.get("terminals")
    if ids is not None and (ids.dtype.kind not in "iu" or ids.ndim != 1):
        raise InvalidInput(f"episodes must be (N,) integers; given {ids.dtype} {ids.shape}")
    if terminals is None:
        assert ids is not None
        return ids
    if terminals.dtype.kind not in "biuf" or terminals.ndim != 1:
        raise InvalidInput(f"terminals must be (N,); given {terminals.dtype} {terminals.shape}")
    if not np.all((terminals == 0) | (terminals == 1)):
        raise InvalidInput("terminals must be 0 or 1")
    if not len(terminals):
        return np.empty(0, np.int64)
    marked = np.concatenate([[0], np.cumsum(terminals[:-1] != 0)])
    if ids is None:
        return marked
    if not np.array_equal(np.diff(ids) != 0, np.diff(marked) != 0):
        raise InvalidInput("episodes and terminals disagree about where episodes end")
    return ids
