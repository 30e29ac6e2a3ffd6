"""Learning curves."""

from adr_service.json_values import Wire


class Evaluation(Wire):
    """One point of a learning curve: the return on the source distribution after some steps."""

    steps: int  # of the environments
    mean_return: float
    standard_error: float  # over the evaluation episodes
