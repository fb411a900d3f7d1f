"""A Ray cluster of two nodes, controlled through standard input; runs in a Python that has Ray.

    nodes.py '{"num_cpus": 2}' '{"num_cpus": 2, "num_gpus": 1}'

Arguments are the resources of the first and the second node. Prints the cluster's address. Reads `kill`, which ends the
second node without notice, and `add`, which starts another like it; each is answered by a line. Ends with its input.
"""

import json
import sys
from typing import Any

from ray.cluster_utils import Cluster

MEMORY = {"object_store_memory": 80 * 2**20}


def main(first: dict[str, Any], second: dict[str, Any]) -> None:
    cluster = Cluster(initialize_head=True, head_node_args={**first, **MEMORY, "include_dashboard": False})
    node = cluster.add_node(**second, **MEMORY)
    print(cluster.address, flush=True)  # noqa: T201 - this is how it answers
    for line in sys.stdin:
        if line == "kill\n":
            cluster.remove_node(node, allow_graceful=False)
        else:
            node = cluster.add_node(**second, **MEMORY)
        print(line.strip(), flush=True)  # noqa: T201
    cluster.shutdown()


if __name__ == "__main__":
    main(*map(json.loads, sys.argv[1:]))
