"""Ray nodes on this machine, in a process of their own: `python -m tests.nodes`.

A head without cores, as in docker-compose.yml. Prints the address; a line on its input, `add` or
`remove`, starts a worker of one core, or ends one without a goodbye; its end ends everything.
"""

import sys
from typing import Any

from ray.cluster_utils import Cluster

MEMORY = {"object_store_memory": 100_000_000}


def main() -> None:
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, **MEMORY})
    workers: list[Any] = []
    say(f"address {cluster.address}")
    for line in sys.stdin:
        if line == "add\n":
            workers.append(cluster.add_node(num_cpus=1, **MEMORY))
        else:
            cluster.remove_node(workers.pop(), allow_graceful=False)
        say("done")
    cluster.shutdown()


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
