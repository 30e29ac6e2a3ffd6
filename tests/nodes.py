"""Ray nodes on this machine, in a process of their own: `python -m tests.nodes`.

A head without cores, as in docker-compose.yml, and two workers of one core. Prints the address; a
line on its input removes a worker without a goodbye, the end of the input ends everything.
"""

import sys

from ray.cluster_utils import Cluster

MEMORY = {"object_store_memory": 100_000_000}


def main() -> None:
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, **MEMORY})
    workers = [cluster.add_node(num_cpus=1, **MEMORY) for _ in range(2)]
    say(f"address {cluster.address}")
    for _ in sys.stdin:
        cluster.remove_node(workers.pop(), allow_graceful=False)
        say("removed")
    cluster.shutdown()


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
