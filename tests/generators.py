"""Running a generator to its end."""


def collect(program):
    """The values that a generator yields, and the value that it returns."""
    values = []
    while True:
        try:
            values.append(next(program))
        except StopIteration as end:
            return values, end.value
