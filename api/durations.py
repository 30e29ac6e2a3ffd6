"""Durations for people."""


def in_words(hours: float) -> str:
    """A duration in words.

    Below a minute, the start of processes takes most of the time, and no plan counts that.
    """
    if hours < 1 / 60:
        return "less than a minute"
    if hours < 1:
        return f"{60 * hours:.0f} minutes"
    return f"{hours:.2g} hours" if hours < 10 else f"{hours:,.0f} hours"
