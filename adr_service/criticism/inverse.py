"""Joint forces that a measured motion needs beyond the simulator's, and effects that supply them.

    block = needed_effects(simulator)   # ((Effect("joint_armature", "joint:wrist", (0.1,)), …), …)

What a control step changes is far from proportional to a large effect, as a rotor that is a hundred
times heavier than its link. The force that a motion needs is not: inverse dynamics is linear in
friction, springs, loads and rotors (Atkeson, An and Hollerbach, 1986). So whatever explains these
forces is chosen first, greedily, by ridge regression with the effects' priors. The forces at the
middle of a step, by differences of noisy readings, allow a first guess alone: predictions judge it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.decision import THRESHOLD, is_evidence
from adr_service.criticism.linear import Normal
from adr_service.criticism.noise import DEGREES
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import MECHANISMS
from adr_service.effects.models import prior_precision, sensible, typical_of

_SHARE = 0.05  # of what is explained already, that one more question must explain
_ROUNDS = 6  # of reweighting
_LEAST = 1e-12  # [N or N m] deviation of a force, where some are exactly as expected

Group = tuple[Effect, ...]  # one effect, or one kind at all of its places


def needed_effects(simulator: Simulator) -> tuple[Group, ...]:
    """Effects and groups that supply the missing forces together, the most important first.

    Nothing if a single question answers it, which the search by predictions judges better, or if
    some position or velocity was not measured: forces take both.
    """
    if not simulator.data.is_measured().all():
        return ()
    search = _Search(simulator)
    chosen = search.chosen()
    return search.answers(chosen) if len(chosen) > 1 else ()


class _Search:
    """Regression of the missing forces on all effects that these are in proportion to."""

    def __init__(self, simulator: Simulator):
        self._missing = missing_forces(simulator, ())
        self._effects = list(_possible(simulator.base))
        parts = [self._columns(simulator, effect) for effect in self._effects]
        self._design = np.concatenate(parts, axis=2)  # (N, nv, p)
        ends = np.cumsum([part.shape[2] for part in parts]).tolist()
        slots = [range(e - part.shape[2], e) for e, part in zip(ends, parts, strict=True)]
        self._slots = dict(zip(self._effects, slots, strict=True))
        self._precision = prior_precision(simulator.base, self._effects)
        self._episodes = np.unique(simulator.data.episode[simulator.starts], return_index=True)[1]

    def chosen(self) -> list[Group]:
        """Questions with evidence, one after the other, as long as one explains a good share."""
        chosen: list[Group] = []
        explained, questions = 0.0, self._questions()
        while True:
            normal = self._normal(chosen)
            before = self._left_out(normal, chosen)
            left = [q for q in questions if not {*q} & {e for known in chosen for e in known}]
            gains = [self._left_out(normal, [*chosen, q]) - before for q in left]
            fair = [g.sum() - THRESHOLD * (len(q) > 1) for g, q in zip(gains, left, strict=True)]
            if not fair:
                return chosen
            best = int(np.argmax(fair))
            if not is_evidence(gains[best]) or fair[best] < max(THRESHOLD, _SHARE * explained):
                return chosen
            explained += fair[best]
            chosen.append(left[best])

    def answers(self, chosen: Sequence[Group]) -> tuple[Group, ...]:
        """The questions at their estimated strengths."""
        sizes = self._normal(chosen).only(self._slots_of(chosen)).change()[0]
        answers: list[Group] = []
        for group in chosen:
            strong: list[Effect] = []
            for effect in group:
                own, sizes = np.split(sizes, [len(effect.values)])
                strong.append(sensible(effect, own * np.array(effect.values)))
            answers.append(tuple(strong))
        return tuple(answers)

    def _questions(self) -> list[Group]:
        kinds: dict[str, list[Effect]] = {}
        for effect in self._effects:
            if len(effect.values) == 1:
                kinds.setdefault(effect.kind, []).append(effect)
        groups = [tuple(group) for group in kinds.values() if len(group) > 1]
        return [*((effect,) for effect in self._effects), *groups]

    def _columns(self, simulator: Simulator, effect: Effect) -> Array3:
        """(N, nv, k) forces that each strength of an effect supplies, one after the other."""
        values, forces = np.zeros(len(effect.values)), [self._missing]
        for number, size in enumerate(effect.values):
            values[number] = size
            forces.append(
                missing_forces(simulator, (replace(effect, values=tuple(values.tolist())),))
            )
        return -np.diff(np.stack(forces, axis=2), axis=2)

    def _slots_of(self, chosen: Sequence[Group]) -> list[int]:
        return [slot for group in chosen for effect in group for slot in self._slots[effect]]

    def _left_out(self, normal: Normal, chosen: Sequence[Group]) -> Vector:
        return normal.only(self._slots_of(chosen)).left_out()

    def _normal(self, chosen: Sequence[Group]) -> Normal:
        """Normal equations of all columns, under the errors that the chosen ones leave: Student's t
        with a deviation for each degree of freedom."""
        slots = self._slots_of(chosen)
        design, precision = self._design[..., slots], np.diag(self._precision[slots])
        nv, left = self._missing.shape[1], self._missing
        weights = np.ones((len(left), 1))
        scale = np.maximum(1.4826 * np.median(np.abs(left), axis=0), _LEAST)
        for _ in range(_ROUNDS):
            root = np.sqrt(weights) / scale  # (N, nv)
            rows, known = design * root[..., None], self._missing * root
            information = np.einsum("nij,nik->jk", rows, rows, optimize=True) + precision
            score = np.einsum("nij,ni->j", rows, known)
            left = self._missing - design @ np.linalg.solve(information, score)
            scale = np.maximum(np.sqrt(np.mean(weights * left**2, axis=0)), _LEAST)
            energy = np.sum((left / scale) ** 2, axis=1, keepdims=True)
            weights = (DEGREES + nv) / (DEGREES + energy)
        root = np.sqrt(weights) / scale
        parts = [
            self._normal_of(part, known, scale)
            for part, known in zip(
                np.split(self._design * root[..., None], self._episodes[1:]),
                np.split(self._missing * root, self._episodes[1:]),
                strict=True,
            )
        ]
        return Normal.joined(parts)

    def _normal_of(self, rows: Array3, known: Matrix, scale: Vector) -> Normal:
        """Normal equations of one episode, from weighted columns and forces."""
        flat, forces = rows.reshape(known.size, -1), known.ravel()
        log_likelihood = -0.5 * forces @ forces - len(known) * np.log(scale).sum()
        return Normal(
            (flat.T @ flat)[None],
            (flat.T @ forces)[None],
            np.array([log_likelihood]),
            np.zeros(flat.shape[1]),
            self._precision,
        )


def _possible(model: mujoco.MjModel) -> Iterator[Effect]:
    """All effects that forces are in proportion to, at typical sizes."""
    for kind, mechanism in MECHANISMS.items():
        if mechanism.in_force:
            for place in mechanism.locations(model):
                typical = typical_of(model, kind, place)
                if typical.any():  # nothing else is possible at an actuator without a gain
                    yield Effect(kind, place, tuple(typical.tolist()))


def missing_forces(simulator: Simulator, effects: Sequence[Effect]) -> Matrix:
    """(N, nv) generalised forces that the measured motion needs beyond those of the actuators, with
    the model's own parameters."""
    states = simulator.measured
    model = simulator.model(simulator.nominal.start, effects)
    data, nv = mujoco.MjData(model), model.nv
    before, after = (states[simulator.starts + k] for k in (0, 1))
    middle, rate = (before + after) / 2, (after - before)[:, nv:] / simulator.period
    commands = simulator.commands((), 1)[:, 0]
    # each access to a field of MuJoCo's data makes an array anew
    qpos, qvel, qacc, ctrl = data.qpos, data.qvel, data.qacc, data.ctrl[: commands.shape[1]]
    inverse, actuator = data.qfrc_inverse, data.qfrc_actuator
    forces = np.empty((len(middle), nv))
    for row, state in enumerate(middle):
        qpos[:], qvel[:], qacc[:], ctrl[:] = state[:nv], state[nv:], rate[row], commands[row]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        forces[row] = inverse - actuator
    return forces
