"""A measurement of a robot: full states and commands over time, episode by episode.

    measurement = Measurement.from_npz(path.read_bytes())

Row k's command is applied from `time[k]` to `time[k + 1]`; the last row of an episode has a state
and a command that nobody executes. Positions and velocities are in the order of the model's
degrees of freedom, in SI units.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Indices, Mask, Matrix, Vector, frozen, spans
from adr_service.errors import InvalidInput
from adr_service.npz import names_in, read_arrays, write_arrays
from adr_service.transitions import MOST_COLUMNS, MOST_EPISODES

_NEEDED = ("time", "qpos", "qvel", "ctrl", "episode")
_OPTIONAL = ("qpos_std", "qvel_std", "ctrl_within")
_SAME = 1e-6  # of the largest command: how near the mean of its parts a row's command must be
_LATEST = 1e12  # seconds
_MOST_IDS = 2**63  # of episodes


@dataclass(frozen=True)
class Measurement:
    """N rows in recording order; rows of one episode are consecutive."""

    time: Vector  # (N,) [s], increasing within an episode
    qpos: Matrix  # (N, nq)
    qvel: Matrix  # (N, nv)
    ctrl: Matrix  # (N, nu)
    episode: Indices  # (N,) non-decreasing
    # (nq,) of the sensors' noise; NaN: to be estimated; inf: not measured. None: estimate all
    qpos_std: Vector | None = None
    qvel_std: Vector | None = None  # (nv,)
    # (N, k, nu) commands in k equal parts of each row, whose mean is `ctrl`; None: each is constant
    ctrl_within: Array3 | None = None
    origin: Indices | None = None  # (N,) rows of the recording that this is a part of; None: whole

    def __post_init__(self) -> None:
        rows = np.size(self.time)
        for name, dimensions in (("time", 1), ("qpos", 2), ("qvel", 2), ("ctrl", 2)):
            values = frozen(getattr(self, name))
            object.__setattr__(self, name, values)
            _check_array(name, values, rows, dimensions)
        episode = np.array(self.episode)
        _check_episodes(episode, self.time)
        object.__setattr__(self, "episode", episode.astype(np.int64))
        if single := [first for first, last in self.spans() if last - first == 1]:
            raise InvalidInput(
                f"the episode at row {single[0]} has a single row, so no transition; leave it out"
            )
        for name, width in (("qpos_std", self.qpos.shape[1]), ("qvel_std", self.qvel.shape[1])):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, _deviations(name, frozen(given), width))
        if self.ctrl_within is not None:
            within = frozen(self.ctrl_within)
            _check_within(within, self.ctrl)
            object.__setattr__(self, "ctrl_within", within)

    @classmethod
    def from_npz(cls, content: bytes) -> "Measurement":
        """Raises InvalidInput with what is missing or wrong."""
        fields = read_arrays(content, [*_NEEDED, *_OPTIONAL])
        if missing := [name for name in _NEEDED if name not in fields]:
            raise InvalidInput(f"the .npz lacks {missing}; it has {sorted(fields)}")
        for name, values in fields.items():
            if values.dtype.kind not in "iuf":
                raise InvalidInput(f"{name} must hold numbers; given {values.dtype}")
        return cls(**fields)

    def to_npz(self) -> bytes:
        """The bytes that `from_npz` reads."""
        known = {name: getattr(self, name) for name in (*_NEEDED, *_OPTIONAL)}
        return write_arrays({name: value for name, value in known.items() if value is not None})

    @classmethod
    def joined(cls, parts: "Sequence[Measurement]") -> "Measurement":
        """Several recordings of one robot as one. Raises InvalidInput if they do not fit."""
        first = parts[0]
        for other in parts[1:]:
            _check_alike(first, other)
        if any(part.ctrl_within is not None for part in parts):
            parts = _with_as_many_parts(parts)
        reaches = [1 + int(part.episode[-1]) - int(part.episode[0]) for part in parts]
        if (most := sum(reaches)) > _MOST_IDS:
            raise InvalidInput(
                f"the episode numbers of recordings that are judged together may span 2**63 in "
                f"all; given are {most}: number each recording's episodes from 0 on"
            )
        counts = np.cumsum([0, *reaches[:-1]], dtype=np.int64)
        return cls(
            time=np.concatenate([part.time for part in parts]),
            qpos=np.concatenate([part.qpos for part in parts]),
            qvel=np.concatenate([part.qvel for part in parts]),
            ctrl=np.concatenate([part.ctrl for part in parts]),
            episode=np.concatenate(
                [p.episode - p.episode[0] + n for p, n in zip(parts, counts, strict=True)]
            ),
            qpos_std=first.qpos_std,
            qvel_std=first.qvel_std,
            ctrl_within=None
            if parts[0].ctrl_within is None
            else np.concatenate([p.ctrl_within for p in parts if p.ctrl_within is not None]),
        )

    def spans(self) -> list[tuple[int, int]]:
        """Half-open row ranges of the episodes."""
        return spans(self.episode)

    def episodes(self, chosen: Sequence[int]) -> "Measurement":
        """The episodes at these positions, in order."""
        spans = self.spans()
        rows = np.concatenate([np.arange(*spans[number]) for number in chosen])
        return replace(
            self,
            time=self.time[rows],
            qpos=self.qpos[rows],
            qvel=self.qvel[rows],
            ctrl=self.ctrl[rows],
            ctrl_within=None if self.ctrl_within is None else self.ctrl_within[rows],
            episode=self.episode[rows],
            origin=self.rows[rows],
        )

    @property
    def rows(self) -> Indices:
        """(N,) of each row, its number in the whole recording."""
        return np.arange(len(self.time)) if self.origin is None else self.origin

    def sensor_variance(self) -> Vector:
        """(nq + nv,) variances of the noise in positions and velocities, NaN if not known.

        An unmeasured column has its variance over the recording.
        """
        parts: list[Vector] = []
        for values, std in ((self.qpos, self.qpos_std), (self.qvel, self.qvel_std)):
            given = np.full(values.shape[1], np.nan) if std is None else std
            parts.append(np.where(np.isinf(given), values.std(axis=0) + 1e-3, given) ** 2)
        return np.concatenate(parts)

    def is_measured(self) -> Mask:
        """(nq + nv,) true for columns whose noise is not infinite."""
        stds = ((self.qpos, self.qpos_std), (self.qvel, self.qvel_std))
        known = [np.zeros(v.shape[1]) if std is None else std for v, std in stds]
        return ~np.isinf(np.concatenate(known))

    def completed(self) -> "Measurement":
        """The measurement with unmeasured columns inferred, where they hold a constant in each
        episode.

        For a model with as many positions as velocities. Unmeasured columns that change stay: their
        file has inferred them already.
        """
        positions, velocities = np.split(~self.is_measured(), 2)
        inside = np.diff(self.episode) == 0
        positions &= ~np.diff(self.qpos, axis=0)[inside].any(axis=0)
        velocities &= ~np.diff(self.qvel, axis=0)[inside].any(axis=0)
        return self.inferring(positions, velocities, self.period())

    def inferring(self, positions: Mask, velocities: Mask, period: float) -> "Measurement":
        """The measurement with these velocities as the rates of their positions, and these
        positions, from each episode's first on, as the integrals of their velocities.

        `positions`, `velocities`: masks (nv,); `period` [s] between rows.
        """
        qpos, qvel = self.qpos.copy(), self.qvel.copy()
        for first, last in self.spans():
            qvel[first:last, velocities] = np.gradient(qpos[first:last, velocities], period, axis=0)
            moved = period * (qvel[first : last - 1] + qvel[first + 1 : last]) / 2
            qpos[first + 1 : last, positions] = qpos[first, positions] + np.cumsum(
                moved[:, positions], axis=0
            )
        return replace(self, qpos=qpos, qvel=qvel)

    def period(self) -> float:
        """Seconds between rows; raises InvalidInput where it is not the same throughout."""
        steps = np.diff(self.time)[np.diff(self.episode) == 0]
        period = float(np.median(steps))
        if (wrong := np.flatnonzero(np.abs(np.diff(self.time) - period) > 0.02 * period)).size:
            inside = [row for row in wrong.tolist() if self.episode[row] == self.episode[row + 1]]
            if inside:
                row = inside[0]
                raise InvalidInput(
                    f"time advances by {self.time[row + 1] - self.time[row]:g} s from row {row} "
                    f"to {row + 1}, elsewhere by {period:g} s; rows must be evenly spaced within "
                    "an episode (start another at a gap; `adr measure` resamples uneven stamps)"
                )
        return period


def _check_array(name: str, values: Matrix, rows: int, dimensions: int) -> None:
    if values.ndim != dimensions or len(values) != rows or values[:1].size > MOST_COLUMNS:
        raise InvalidInput(
            f"{name} has shape {values.shape}; expected are {rows} rows, as many as `time`"
            f" has, in {dimensions} dimension{'s' * (dimensions > 1)}, and at most {MOST_COLUMNS} "
            "columns"
        )
    if not np.all(np.isfinite(values)):
        where = np.argwhere(~np.isfinite(values))[0].tolist()
        column = f", column {where[1]}" if len(where) > 1 else ""
        raise InvalidInput(f"{name} is not finite at row {where[0]}{column}")


def _check_alike(first: Measurement, other: Measurement) -> None:
    """Raises InvalidInput unless two recordings have the same columns, period and sensors."""
    for name in ("qpos", "qvel", "ctrl"):
        one, two = (getattr(each, name).shape[1] for each in (first, other))
        if one != two:
            raise InvalidInput(
                f"recordings that are judged together have the same columns; {name} has {one} in "
                f"the first and {two} in another"
            )
    if abs(first.period() - other.period()) > 1e-3 * first.period():
        raise InvalidInput(
            f"rows of recordings that are judged together are equally far apart; given are "
            f"{first.period():g} and {other.period():g} s"
        )
    for name in ("qpos_std", "qvel_std"):
        one, two = getattr(first, name), getattr(other, name)
        known = (np.nan if std is None else std for std in (one, two))  # None, too, is unknown
        if not np.array_equal(*np.broadcast_arrays(*known), equal_nan=True):
            raise InvalidInput(
                f"recordings that are judged together have the same sensors; {name} is "
                f"{_listed(one)} in the first and {_listed(two)} in another"
            )


def _listed(std: Vector | None) -> str:
    return "not given" if std is None else str(std.tolist())


def _with_as_many_parts(parts: "Sequence[Measurement]") -> "list[Measurement]":
    """Recordings whose rows all have commands in as many parts."""
    withins = [p.ctrl[:, None] if p.ctrl_within is None else p.ctrl_within for p in parts]
    most = int(np.lcm.reduce([within.shape[1] for within in withins]))
    return [
        replace(part, ctrl_within=np.repeat(within, most // within.shape[1], axis=1))
        for part, within in zip(parts, withins, strict=True)
    ]


def _check_within(within: Array3, ctrl: Matrix) -> None:
    if within.ndim != 3 or within.shape[::2] != ctrl.shape or not within.shape[1]:
        rows, width = ctrl.shape
        raise InvalidInput(
            f"ctrl_within has shape {within.shape}; expected is ({rows}, k, {width}): the commands "
            "in k equal parts of each row"
        )
    most = np.abs(within).max(initial=0.0)
    if not np.allclose(within.mean(axis=1), ctrl, rtol=0, atol=_SAME * most):  # NaN differs too
        raise InvalidInput("ctrl must be the mean of ctrl_within over the parts of each row")


def _check_episodes(episode: Indices, time: Vector) -> None:
    """Refuse episode numbers and times that are not in recording order."""
    rows = len(time)
    if episode.shape != (rows,) or episode.dtype.kind not in "iu":
        raise InvalidInput(
            f"episode has shape {episode.shape} and type {episode.dtype}; expected are {rows} "
            "whole numbers"
        )
    if (most := episode.max(initial=0)) >= _MOST_IDS:
        raise InvalidInput(f"episodes must be whole numbers below 2**63; given {most}")
    if (back := np.flatnonzero(episode[1:] < episode[:-1])).size:  # unsigned differences wrap
        raise InvalidInput(f"episode numbers must not decrease; they do at row {back[0] + 1}")
    if not rows:
        raise InvalidInput("the measurement has no rows")
    if (longest := np.abs(time).max()) > _LATEST:
        raise InvalidInput(f"time is in seconds, up to {_LATEST:g}; given up to {longest:g}")
    late = (np.diff(time) <= 0) & (np.diff(episode) == 0)
    if late.any():
        row = int(np.flatnonzero(late)[0])
        raise InvalidInput(
            f"time must increase within an episode; it goes from {time[row]:g} to "
            f"{time[row + 1]:g} s at row {row + 1}"
        )
    if (count := 1 + np.count_nonzero(np.diff(episode))) > MOST_EPISODES:
        raise InvalidInput(
            f"a measurement has {MOST_EPISODES:,} episodes at most; this has {count:,}"
        )


def _deviations(name: str, given: Vector, width: int) -> Vector:
    """Standard deviations (width,) of sensors, from one for each or one for all."""
    if given.shape not in ((), (width,)) or np.any(given < 0):
        raise InvalidInput(
            f"{name} must be {width} numbers that are not negative, or NaN for those to be "
            f"estimated; given {given.tolist()}"
        )
    return frozen(np.broadcast_to(given, (width,)))


def is_measurement(content: bytes) -> bool:
    """True if an `.npz` is meant to be a measurement, and not transitions."""
    return "qpos" in names_in(content)
