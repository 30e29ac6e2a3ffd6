"""Play schedules again, with what the service logs and when.

python -m tests.workers.schedules SEED...
"""

import logging
import sys

from tests.workers.schedules.playing import play_all

if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(created).2f %(name)s: %(message)s")
    sys.stdout.write(f"{play_all(int(seed) for seed in sys.argv[1:])}\n")
