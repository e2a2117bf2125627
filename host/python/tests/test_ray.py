"""Studies on a Ray cluster of two nodes on this machine, one of which is killed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import r4
import ray
from ray.cluster_utils import Cluster

# Ray's own, of its use of the standard library.
pytestmark = pytest.mark.filterwarnings("ignore")

# For nodes that start and tasks that come, on a machine that does other things too.
PATIENCE_S = 120.0
STUDY = {"system": "skidcal", "arms": ["paper"], "first_seed": 1, "seeds": 8}


@pytest.fixture()
def cluster() -> Iterator[Cluster]:
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster
    ray.shutdown()
    cluster.shutdown()


def wait_until(is_so) -> None:
    end = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.02)


def is_working(raylet: int) -> bool:
    """Returns whether a worker of this node is executing a part of a study: Ray names its processes so."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            name = (process / "cmdline").read_bytes()
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
        if name.startswith(b"ray::run_part") and parent == raylet:
            return True
    return False


def test_a_study_survives_a_machine_that_dies(cluster: Cluster) -> None:
    victim = cluster.add_node(num_cpus=1)
    found: list[r4.Study] = []
    study = threading.Thread(target=lambda: found.append(r4.study(**STUDY, engine="ray")))
    study.start()
    [raylet] = victim.all_processes["raylet"]
    wait_until(lambda: is_working(raylet.process.pid))
    assert not found
    cluster.remove_node(victim, allow_graceful=False)
    study.join(PATIENCE_S)
    assert found == [r4.study(**STUDY)]
    wait_until(lambda: [node["Alive"] for node in ray.nodes()].count(True) == 1)


def test_what_a_study_refuses_is_the_same_on_a_cluster(cluster: Cluster) -> None:
    with pytest.raises(r4.NotStudied, match="none"):
        r4.study("skidcal", arms=["none"], engine="ray")
    with pytest.raises(ValueError, match="leave shard out"):
        r4.study("skidcal", shard="1/2", engine="ray")
    with pytest.raises(ValueError, match="threads"):
        r4.study("skidcal", engine="dask")
