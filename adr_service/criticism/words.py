"""Numbers of a verdict in words, alike in the report and on a terminal."""


def sure(probability: float) -> str:
    """How sure a verdict is; never wholly."""
    return f"{'more than 99.9' if probability > 0.999 else f'{100 * probability:.1f}'} % sure"
