"""The two consoles that commands write to: text as it is, in which brackets are no markup."""

import os
import sys

from rich.console import Console

# a table needs a width where the output is not a terminal
console = Console(
    width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else 120, markup=False
)
errors = Console(stderr=True, markup=False)
