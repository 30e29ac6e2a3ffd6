"""A flexible force on the joints, which may predict better than any named effect.

    rest = unexplained(baseline)
    rest.gains, rest.where

A ridge regression of the whitened residuals on generalised forces, for one question after the
other: does what is left depend on motion and commands, on where a joint is, on time, on how a drive
is used, or does it swing at one frequency? Where the best of these predicts episodes that it has
not seen better than the named effects do, they are not the whole story. One question at a time,
because what the others would add is noise.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.ndimage import median_filter

from adr_service.arrays import Array3, Indices, Matrix, Vector
from adr_service.criticism.evidence import gained
from adr_service.criticism.fits import Fit
from adr_service.criticism.linear import Linear, Normal, estimate
from adr_service.criticism.noise import Whitener
from adr_service.criticism.periods import PADDED, power_of, pulls
from adr_service.criticism.responses import responses_to_forces
from adr_service.criticism.verdict import Dependence, Rest
from adr_service.effects.actuators import drives, is_affine, obeys_limits

_SLOWEST = 3  # swings in a recording; less is a drift
_AROUND = 30  # resolved frequencies to either side, above which one has to stand out
_RIDGES = (0.01, 0.1, 1.0, 10.0)  # prior precisions, relative to the information in all data
_WAVES = (1, 2, 3, 4, 6, 8, 12, 16)  # in a turn of a hinge; of a slide, half waves of its range


@dataclass(frozen=True)
class Unexplained:
    """The part of what a fit leaves that the best flexible force explains."""

    gains: Vector  # (E,) nats by episode left out
    where: Rest


@dataclass(frozen=True)
class _Regression:
    """A fit with forces that depend on one thing."""

    depends_on: Dependence
    linear: Linear  # with the best ridge
    normal: Normal  # under the noise of the fit without
    columns: tuple[range, ...]  # by degree of freedom
    excess: float = 1.0  # factor by which noise alone gains more than white noise would


def unexplained(fit: Fit) -> Unexplained:
    """The best flexible force beside a fit, if only by chance."""
    responses = responses_to_forces(fit)
    swing = _swing(fit, responses)
    asked = list(_regressions(fit, responses, swing))
    if fit.persistence.share == 0:  # else what wins under white noise may win nothing beside it
        asked = [max(asked, key=lambda each: _roughly_gained(fit, each))]
    gains, best = max(((_gained(fit, each), each) for each in asked), key=lambda one: one[0].sum())
    is_swing = best.depends_on == "frequency"
    where = Rest(_location(fit, best), best.depends_on, swing.hertz if is_swing else None)
    return Unexplained(gains, where)


def _roughly_gained(fit: Fit, one: "_Regression") -> float:
    """[nats] under the noise of the fit without the force."""
    return float((one.normal.left_out() - fit.held_out).sum()) / one.excess


def _gained(fit: Fit, one: "_Regression") -> Vector:
    """(E,) nats, with the noise estimated anew."""
    noise, normal = estimate(one.linear, fit.noise, fit.stated)
    return gained(replace(fit, linear=one.linear, noise=noise, normal=normal), fit) / one.excess


def _regressions(fit: Fit, responses: Sequence[Matrix], swing: "_Swing") -> Iterator[_Regression]:
    moments = [_Moment.of(fit, dof) for dof in range(len(responses))]
    for depends_on, terms in _TERMS.items():
        forces = [
            r[:, :, None] * terms(m)[:, None, :] for r, m in zip(responses, moments, strict=True)
        ]
        yield _regression(fit, depends_on, forces)
    yield replace(_regression(fit, "frequency", swing.forces), excess=swing.excess)


def _regression(fit: Fit, depends_on: Dependence, forces: Sequence[Array3]) -> _Regression:
    """Forces (N, m, k) on each degree of freedom, with the ridge that predicts best."""
    base = fit.linear.columns.shape[3]
    folded = fit.layout.fold(np.concatenate(forces, axis=2))
    folded[~fit.linear.chain.mask] = 0.0
    nothing = np.zeros(folded.shape[3])
    plain = replace(
        fit.linear,
        columns=np.concatenate([fit.linear.columns, folded], axis=3),
        mean=np.concatenate([fit.linear.mean, nothing]),
        precision=np.concatenate([fit.linear.precision, nothing]),
    )
    normal = Normal.of(Whitener.of(plain.chain, fit.noise), plain)
    information = np.diagonal(normal.information.sum(axis=0)) * (np.arange(len(plain.mean)) >= base)
    penalised = [
        replace(normal, precision=plain.precision + ridge * information) for ridge in _RIDGES
    ]
    best = max(penalised, key=lambda each: each.left_out().sum())
    ends = base + np.cumsum([force.shape[2] for force in forces])
    columns = tuple(
        range(end - force.shape[2], end) for end, force in zip(ends.tolist(), forces, strict=True)
    )
    return _Regression(depends_on, replace(plain, precision=best.precision), best, columns)


def _location(fit: Fit, best: _Regression) -> str:
    """The joint where a flexible force alone explains most."""
    own, model = list(range(fit.linear.columns.shape[3])), fit.simulator.base
    alone = [best.normal.only([*own, *columns]).left_out().sum() for columns in best.columns]
    return f"joint:{model.joint(model.dof_jntid[int(np.argmax(alone))]).name}"


@dataclass(frozen=True)
class _Swing:
    """A sine and a cosine at one frequency, on one degree of freedom."""

    forces: list[Array3]  # (N, m, 2) their effects; (N, m, 0) on all others
    hertz: float
    excess: float  # of what frequencies around it gain, over what most do


def _swing(fit: Fit, responses: Sequence[Matrix]) -> _Swing:
    """The swing that gains most; episodes are parts of one recording, whose rows are a period
    apart.

    What frequencies around it gain as well comes from forces that are correlated in time, and only
    what is beyond that counts. Degree of freedom and frequency are chosen from all episodes. By
    that choice, chance gains about 10 nats (the logarithm of the number of choices).
    """
    simulator, pull = fit.simulator, pulls(fit, responses)
    when = simulator.data.rows[simulator.starts]
    power = _power(pull, when)
    dof, wave = np.unravel_index(np.argmax(power / _excess(power)), power.shape)
    turns = int(wave) / (PADDED * (int(when[-1]) + 1))  # in a control step
    angle = 2 * np.pi * turns * when
    swung = np.column_stack([np.sin(angle), np.cos(angle)])
    forces = [
        r[:, :, None] * (swung if n == dof else swung[:, :0])[:, None]
        for n, r in enumerate(responses)
    ]
    own = pull[dof] - swung @ np.linalg.lstsq(swung, pull[dof], rcond=None)[0]  # it leaks
    return _Swing(
        forces, turns / simulator.period, float(_excess(_power(own[None], when))[0, wave])
    )


def _power(pull: Matrix, when: Indices) -> Matrix:
    """(d, F) squared Fourier sums of pulls (d, N) in time; zero below the slowest swing."""
    power = power_of(pull, when, PADDED * (int(when[-1]) + 1))
    power[:, : _SLOWEST * PADDED] = 0.0
    return power


def _excess(power: Matrix) -> Matrix:
    """(d, F) power at the frequencies around each, over that at most, where it is more."""
    slowest = _SLOWEST * PADDED
    around = median_filter(power[:, slowest:], (1, 2 * _AROUND * PADDED + 1), mode="mirror")
    typical = np.maximum(np.median(around, axis=1, keepdims=True), 1e-300)
    return np.pad(np.maximum(around / typical, 1.0), ((0, 0), (slowest, 0)), constant_values=1.0)


@dataclass(frozen=True)
class _Moment:
    """All that a force on one degree of freedom could depend on, for each transition."""

    q: Vector  # (N,) position
    v: Vector
    direction: Vector  # (N,) of motion, smooth about standstill
    wave: float  # angle of the slowest wave, by unit of position
    commands: Matrix  # (N, nu)
    before: Matrix  # (N, nu) commands of the step before; an episode's first at first
    own: Matrix  # (N, …) forces of its actuators, and commands of those on no single joint
    elapsed: Vector  # (N,) time in the episode, -1 to 1
    whole: Vector  # (N,) place in the whole recording, -1 to 1

    @classmethod
    def of(cls, fit: Fit, dof: int) -> "_Moment":
        simulator, model = fit.simulator, fit.simulator.base
        starts, count = simulator.starts, len(simulator.starts)
        q, v = fit.states[starts, dof], fit.states[starts, model.nv + dof]
        commands = simulator.data.ctrl[starts]
        first = np.r_[True, np.diff(simulator.data.episode[starts]) != 0]
        steps = np.arange(count) - np.maximum.accumulate(np.where(first, np.arange(count), 0))
        joint = model.dof_jntid[dof]
        elsewhere = np.flatnonzero(model.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT)
        acting = np.union1d(drives(model, joint), elsewhere).astype(int)
        is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        return cls(
            q,
            v,
            direction=np.tanh(v / (0.1 * max(float(v.std()), 1e-6))),
            wave=1.0 if is_hinge else np.pi / max(float(np.ptp(q)), 1e-6),
            commands=commands,
            before=np.where(first[:, None], commands, np.roll(commands, 1, axis=0)),
            own=_own_forces(model, acting[acting < commands.shape[1]], commands, q, v),
            elapsed=2 * steps / max(int(steps.max()), 1) - 1,
            whole=np.linspace(-1.0, 1.0, count),
        )


def _own_forces(
    model: mujoco.MjModel, acting: Indices, commands: Matrix, q: Vector, v: Vector
) -> Matrix:
    """(N, k) forces of a joint's drives at its states (N,), before their gears.

    A servo's is not its command. Of an actuator elsewhere, or of another kind, it is the command.
    """
    own, fixed = commands[:, acting], mujoco.mjtGain.mjGAIN_FIXED
    limits = model.actuator_ctrlrange
    for column, number in enumerate(acting.tolist()):
        is_fixed = model.actuator_gaintype[number] == fixed and is_affine(model, number)
        if not is_fixed or model.actuator_trntype[number] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        given = (
            np.clip(own[:, column], *limits[number])
            if obeys_limits(model)[number]
            else own[:, column]
        )
        force = model.actuator_gainprm[number, 0] * given
        if model.actuator_biastype[number] == mujoco.mjtBias.mjBIAS_AFFINE:
            bias, gear = model.actuator_biasprm[number], model.actuator_gear[number, 0]
            force = force + bias[0] + gear * (bias[1] * q + bias[2] * v)
        if model.actuator_forcelimited[number]:
            force = np.clip(force, *model.actuator_forcerange[number])
        own[:, column] = force
    return own


def _motion_terms(at: _Moment) -> Matrix:
    """Springs and friction of any smooth shape, and what any actuator is commanded."""
    q, v, speed = at.q, at.v, np.abs(at.v)
    own = [np.ones_like(q), q, q**2, q**3, q * v, v, v * speed, v**3, np.maximum(v, 0.0)]
    pushed = [at.commands, at.before, at.commands * v[:, None], np.abs(at.commands)]
    return np.column_stack([*own, at.direction, at.direction * v**2, *pushed])


def _position_terms(at: _Moment) -> Matrix:
    """Ripple, and friction that differs from place to place."""
    angles = np.outer(at.wave * at.q, _WAVES)
    waves = np.column_stack([np.sin(angles), np.cos(angles)])
    own = [np.ones_like(at.q), at.q, at.v, at.direction]
    return np.column_stack([*own, waves, at.direction[:, None] * waves])


def _time_terms(at: _Moment) -> Matrix:
    """Friction and gains that change within an episode, or over the recording."""
    one = np.ones_like(at.q)
    slow = np.column_stack([one, at.elapsed, at.elapsed**2, at.whole, at.whole**2])
    changing = np.column_stack([one, at.v, at.direction, at.own])
    return np.column_stack([changed[:, None] * slow for changed in changing.T])


def _drive_terms(at: _Moment) -> Matrix:
    """Gains that depend on position, speed and load, and friction that depends on load."""
    angles, own = at.wave * at.q, at.own
    by = [np.ones_like(at.q), at.q, np.sin(angles), np.cos(angles)]
    by += [np.sin(2 * angles), np.cos(2 * angles), np.abs(at.v)]
    turned = [own * each[:, None] for each in by]
    return np.column_stack([*turned, own**3, np.abs(own) * at.direction[:, None]])


_TERMS: dict[Dependence, Callable[[_Moment], Matrix]] = {
    "motion": _motion_terms,
    "position": _position_terms,
    "time": _time_terms,
    "drive": _drive_terms,
}
