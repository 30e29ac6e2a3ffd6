"""A criticism as an HTML page, for readers who do not know its statistics."""

import json
from html import escape
from typing import Any

import mujoco

import adr_service
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.extension import Extension
from adr_service.criticism.figures import draw_all
from adr_service.criticism.page import page, table, wide
from adr_service.criticism.pipeline import Criticism
from adr_service.criticism.verdict import (
    Conclusion,
    Gain,
    NamedCause,
    Residual,
    Verdict,
    in_smaller_steps,
    share_text,
    sure,
)

EXTENDED = "extended.xml"
FILES = ("verdict.json", "report.html", EXTENDED, "effects.json")


def report_page(criticism: Criticism, name: str, origin: str) -> str:
    """HTML with its figures inside; `name` is what was criticised, and `origin` by what and when:
    "measured.npz, seed 0, 2026-11-26"."""
    verdict = criticism.verdict
    pictures = {figure: wide(svg) for figure, svg in draw_all(criticism).items()}
    parts = [f'<p class="finding">{_finding(verdict)}</p>', _origin(criticism, origin)]
    parts.append(_bounds(verdict))
    parts += [f"<p>{escape(remark)}</p>" for remark in verdict.remarks]
    if verdict.causes:
        parts.append(_causes(verdict))
    if criticism.extension is not None:
        names = criticism.final.simulator.nominal.space.names
        parts.append(_in_mjcf(criticism.extension, names))
    if verdict.gain is not None:
        parts.append(_gain(verdict.gain, verdict.residual))
    parts.append("<h2>Where the error is</h2>" + pictures["where"])
    explained = _EVIDENCE.format(_REFINED if verdict.causes else "")
    parts.append("<h2>What would explain it</h2>" + explained + pictures["ranking"])
    if "residual" in pictures:
        parts.append("<h2>The cause in the data</h2>" + pictures["residual"])
        parts.append("<h2>What the extended simulator is worth</h2>" + pictures["horizons"])
        parts.append(pictures["trace"])
    parts += [_moved(criticism), _detectable(verdict), _confused(verdict)]
    return page(f"What {name} gets wrong", parts)


def files_of(criticism: Criticism, name: str, origin: str) -> dict[str, bytes]:
    """The verdict, the page and, where something was named, the extended model, by file name.

    `name` and `origin` are those of `report_page`.
    """
    extension = criticism.extension
    verdict = json.dumps(criticism.verdict.to_json(), indent=1)
    texts = [verdict, report_page(criticism, name, origin)]
    if extension is not None:
        texts += [extension.xml, json.dumps(extension.to_json(), indent=1)]
    return {file: text.encode() for file, text in zip(FILES, texts, strict=False)}


_EVIDENCE = (
    "<p>Evidence is how much better episodes are predicted that the fit has not seen, as the "
    "logarithm of a probability: 4.6 nats mean a hundred times more probable. Below "
    f"{THRESHOLD:g} nats we call it chance. Bars are a first look, to first order and with the "
    "noise that the simulator had without a cause.{}</p>"
)
_REFINED = " Diamonds are the refined evidence of the causes in the table above."


def _finding(verdict: Verdict) -> str:
    how_sure = sure(verdict.confidence)
    match verdict.conclusion:
        case Conclusion.NONE:
            return (
                f"Nothing is missing that these data could show ({how_sure}). The table at the end "
                "says how large an effect would have been seen."
            )
        case Conclusion.UNKNOWN:
            spread = "; ".join(_words(cause) for cause in verdict.causes)
            return (
                f"Something is missing that is none of the effects we know ({how_sure}): "
                f"{_flexible(verdict.residual)} than the best of them. "
                f"{_suspects(verdict.residual)}"
                f"{f' Besides, the simulator lacks {spread}.' if spread else ''}"
            )
        case Conclusion.CAUSE | Conclusion.TIE:
            names = "; ".join(_words(cause) for cause in verdict.causes)
            tie = (
                " Other causes explain as much; see below."
                if verdict.conclusion == Conclusion.TIE
                else ""
            )
            rest = ""
            if verdict.residual.rest == "unknown":
                rest = (
                    " Something else is missing that is none of the effects we know: "
                    f"{_flexible(verdict.residual)} than these alone. "
                    f"{_suspects(verdict.residual)}"
                )
            return f"The simulator lacks {names} ({how_sure}).{tie}{rest}"


def _origin(criticism: Criticism, origin: str) -> str:
    """The data behind the verdict, and the versions that judged them."""
    residual, data = criticism.verdict.residual, criticism.baseline.simulator.data
    diverged = f" ({residual.diverged} more diverged)" if residual.diverged else ""
    return (
        f"<p>From {escape(origin)}. Fitted to {residual.used} transitions{diverged} in "
        f"{len(data.spans())} episodes; the others were set aside. "
        f"ADR benchmark {adr_service.__version__}, MuJoCo {mujoco.__version__}.</p>"
    )


def _suspects(residual: Residual) -> str:
    return f"Look for {residual.where.suspects}."


def _flexible(residual: Residual) -> str:
    return f"{escape(residual.where.words)} predicts {residual.unexplained_nats:.0f} nats better"


def _bounds(verdict: Verdict) -> str:
    """A warning where a parameter wanted to go further than it may."""
    names = ", ".join(map(escape, verdict.residual.at_bound))
    if not names:
        return ""
    return (
        f"<p><b>Not to be relied on:</b> {names} went to the edge of what it may be. Give it wider "
        "bounds, and judge again.</p>"
    )


def _words(cause: NamedCause) -> str:
    kind = escape(cause.kind.replace("_", " "))
    place = "" if cause.location == "global" else f" at {escape(cause.location)}"
    return f"<b>{kind}{place}</b>"


def _causes(verdict: Verdict) -> str:
    rows: list[list[Any]] = []
    for cause, tied in zip(verdict.causes, verdict.tied, strict=True):
        rows += _rows(cause, "")
        for other in tied:
            rows += _rows(other, "or: ")
    heads = ["cause", "strength", "value", "95 % interval", "unit", "evidence [nats]"]
    return "<h2>Causes</h2>" + table(heads, rows) + _advice(verdict)


def _in_mjcf(extension: Extension, free: tuple[str, ...]) -> str:
    """Changes of the file, to be written into one's own, and the parameters that are free."""
    lines = [f"<li><code>{escape(change)}</code></li>" for change in extension.changes]
    beside = [f"{effect.kind} {effect.location}" for effect in extension.beside]
    if beside:
        lines.append(f"<li>MJCF cannot express {escape(', '.join(beside))}: see effects.json.</li>")
    if free:
        lines.append(
            f"<li>Free parameters were fitted again beside these ({escape(', '.join(free))}): take "
            "their values from extended.xml.</li>"
        )
    return "<h2>In your MJCF</h2><ul>" + "".join(lines) + "</ul>"


def _advice(verdict: Verdict) -> str:
    """Experiments with the robot that would separate tied causes."""
    lines: list[str] = []
    for cause, tied, experiments in zip(
        verdict.causes, verdict.tied, verdict.experiments, strict=True
    ):
        for other, experiment in zip(tied, experiments, strict=True):
            apart = (
                f"{escape(experiment.description)}: the two simulators would then differ by "
                f"{experiment.separation:.1f} times what noise lets expect of a step, on average; "
                f"in these data by {experiment.recorded:.1f}"
            )
            if not experiment.is_seen:
                apart = (
                    "in none of the experiments that we tried, with one actuator at a time, does "
                    "what the robot does depend on which it is"
                )
            elif not experiment.is_worth_it:
                apart = (
                    "none of the experiments that we tried, with one actuator at a time, "
                    "separates them further than whole episodes of these data do"
                )
            lines.append(f"<li>{_words(cause)} from {_words(other)}: {apart}.</li>")
    listed = "<h2>Experiments that would separate them</h2><ul>" + "".join(lines) + "</ul>"
    return listed if lines else ""


def _rows(cause: NamedCause, prefix: str) -> list[list[Any]]:
    return [
        [
            prefix + _words(cause),
            escape(e.name),
            f"{e.value:.4g}",
            e.interval,
            escape(e.unit),
            f"{cause.gain:.0f}",
        ]
        for e in cause.strengths
    ]


def _gain(gain: Gain, residual: Residual) -> str:
    share = gain.explainable_fraction
    rest = ""
    if share is not None and gain.explainable_interval is not None:
        rest = (
            f": {share_text(share, *gain.explainable_interval)} of what is neither noise nor left"
        )
    finer = ""
    if residual.step < residual.own_step:
        finer = f" Both were {in_smaller_steps(residual.step, residual.own_step)}."
    return (
        f"<p>On episodes that nothing was fitted to, the extended simulator removes "
        f"{share_text(gain.sse_removed, gain.low, gain.high)} of the "
        f"squared error of one control step, of predictions by a filter that knows the "
        f"noise{rest}.{finer}</p>"
    )


def _moved(criticism: Criticism) -> str:
    verdict = criticism.verdict
    moved = verdict.residual.moved
    if not moved:
        return ""
    units = {p.name: p.unit for p in criticism.baseline.simulator.nominal.space.parameters}
    rows = [
        [escape(name), escape(units[name]), f"{before:.4g}", f"{after:.4g}"]
        for name, (before, after) in moved.items()
    ]
    heads = ["parameter", "unit", "fitted to the simulator as it is", "to the extended one"]
    if not verdict.causes:
        rows, heads = [row[:3] for row in rows], heads[:3]
    text = (
        "<p>A parameter that moves was bent to hide what the simulator lacks: a wider "
        "distribution of it would not have helped.</p>"
    )
    return "<h2>The free parameters</h2>" + (text if verdict.causes else "") + table(heads, rows)


def _detectable(verdict: Verdict) -> str:
    rows = [
        [escape(name), f"{size:.3g}", escape(unit)]
        for name, (size, unit) in sorted(verdict.residual.detectable.items())
    ]
    heads = ["effect", "smallest strength that would have been seen", "unit"]
    return (
        "<details><summary>How large an effect would have been seen, alone, by the simulator as it "
        "is; what is not listed was not tried, or cannot be seen in these data (steps and noise of "
        "sensors are judged apart)</summary>" + table(heads, rows) + "</details>"
    )


def _confused(verdict: Verdict) -> str:
    groups = verdict.residual.confused
    if not groups:
        return ""
    lines = "".join(f"<li>{escape(', or '.join(names))}</li>" for names in groups)
    return (
        "<details><summary>What these data cannot tell apart, beside the free parameters: in each "
        "line, any of the strengths does the same as the others</summary>"
        f"<ul>{lines}</ul></details>"
    )
