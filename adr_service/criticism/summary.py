"""Numbers of a verdict, from the fits of a criticism."""

from collections.abc import Sequence

import numpy as np

from adr_service.criticism.decision import is_evidence
from adr_service.criticism.fits import Fit
from adr_service.criticism.flexible_force import Unexplained
from adr_service.criticism.intervals import intervals
from adr_service.criticism.scan import Candidate, location_of
from adr_service.criticism.verdict import NamedCause, Residual
from adr_service.criticism.weighing import Weighed
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import unit_of


def alternative(other: Weighed) -> NamedCause:
    """An equally good cause, with the strengths that it has in the named one's place."""
    count = len(other.fit.effects)
    return named_cause(other.fit, slice(count - len(other.effects), count), other)


def named_cause(fit: Fit, slot: slice, weighed: Weighed) -> NamedCause:
    """Some of a fit's effects with intervals, as one cause or a group."""
    effects = fit.effects[slot]
    strengths = intervals(fit, slot)
    return NamedCause(
        effects[0].kind, location_of(effects), strengths, weighed.confidence, weighed.gain
    )


def residual_of(
    baseline: Fit,
    final: Fit,
    first: Sequence[Candidate],
    confused: tuple[tuple[str, ...], ...],
    flexible: Unexplained,
) -> Residual:
    """Everything that the final fit leaves, and what the first scan could see.

    `confused`: groups of strengths that these data cannot tell apart. `flexible`: what a flexible
    force explains beside the final fit.
    """
    simulator, space = final.simulator, final.simulator.nominal.space
    used = int(final.linear.chain.mask.sum())
    at_bound = (final.parameters <= space.feasible_low) | (final.parameters >= space.high)
    fitted = zip(baseline.parameters.tolist(), final.parameters.tolist(), strict=True)
    return Residual(
        noise=tuple(
            float(np.sqrt(variance)) if is_measured else None
            for variance, is_measured in zip(
                final.noise.sensor, simulator.data.is_measured(), strict=True
            )
        ),
        step=simulator.base.opt.timestep / simulator.finer,
        own_step=simulator.base.opt.timestep,
        unexplained_nats=float(flexible.gains.sum()),
        rest="unknown" if is_evidence(flexible.gains) else "none",
        where=flexible.where,
        moved=dict(zip(space.names, fitted, strict=True)),
        at_bound=tuple(n for n, is_at in zip(space.names, at_bound, strict=True) if is_at),
        used=used,
        diverged=int(final.layout.mask.sum()) - used,
        detectable=_detectable(final, first),
        confused=confused,
    )


def _detectable(final: Fit, first: Sequence[Candidate]) -> dict[str, tuple[float, str]]:
    """Smallest strength of each effect that would have been evidence, and its unit: its first, or
    else the first that could be, under its name."""
    limits: dict[str, tuple[float, str]] = {}
    for candidate in first:
        seen = np.flatnonzero(np.isfinite(candidate.limits))
        if len(candidate.effects) > 1 or not seen.size:
            continue
        strength = get_mechanism(candidate.kind).strengths[seen[0]]
        name = f"{candidate.kind} {candidate.location}"
        limits[f"{name} {strength.name}" if seen[0] else name] = (
            float(candidate.limits[seen[0]]),
            unit_of(final.simulator.base, candidate.location, strength.unit),
        )
    return limits
