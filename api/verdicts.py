"""A criticism's verdict in sentences, for the terminal and the page."""

from adr_service.client import Json
from adr_service.criticism.verdict import Rest, in_smaller_steps, share_text, sure


def told(verdict: Json) -> list[str]:
    """Lines on a verdict: how sure it is, reasons to doubt it, its gain, and remarks."""
    return [
        f"{verdict['verdict']}, {sure(verdict['confidence'])}",
        *_warnings(verdict),
        *_gain(verdict),
        *verdict["remarks"],
    ]


def _warnings(verdict: Json) -> list[str]:
    """Reasons to doubt the verdict."""
    lines: list[str] = []
    moved = verdict["residual"]["parameters"]
    if at_bound := ", ".join(name for name, each in moved.items() if each["at_bound"]):
        lines.append(
            f"do not rely on it: {at_bound} is at the edge of its bounds (are the order and the "
            "units of the columns the model's? are the bounds wide enough?)"
        )
    if verdict["residual"]["rest"] == "unknown":
        lines += _rest(verdict)
    return lines


def _rest(verdict: Json) -> list[str]:
    """Lines on what the named causes leave unexplained, and at which joint."""
    lines: list[str] = []
    if verdict["causes"]:
        lines.append("something else is missing that is none of the effects we know")
    if where := verdict["residual"].get("where"):  # stored verdicts of earlier versions lack it
        rest = Rest(**where)
        lines.append(f"what is left is best explained by {rest.words}: look for {rest.suspects}")
    return lines


def _gain(verdict: Json) -> list[str]:
    """Gain on episodes set aside, and the time step that it was measured with."""
    gain, step = verdict["gain"], verdict["residual"].get("timestep")
    if gain is None:
        return []
    removed = share_text(gain["sse_removed"], gain["low"], gain["high"])
    lines = [
        f"on episodes set aside, {removed} of the squared error "
        "one step ahead is gone (of a filter that knows the sensors' noise)"
    ]
    if step and step["judged_with"] < step["of_the_model"]:
        lines.append(in_smaller_steps(step["judged_with"], step["of_the_model"]))
    return lines
