"""Studies on a Ray cluster: parts as tasks, which are run again where a worker or its machine dies."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from . import _native, analysis
from .errors import NotStudied

#: Parts per processor of the cluster, not tuned. More parts lose less work with a worker and balance the end of a study better; each costs a
#: task's overhead.
PARTS_PER_CPU = 4


def build() -> str:
    """Returns the SHA-256 of the compiled library: records are comparable only if all machines run the same one."""
    return hashlib.sha256(Path(_native.__file__).read_bytes()).hexdigest()


def run_part(asked: dict[str, Any], shard: str) -> tuple[str, list[dict[str, Any]]]:
    """Runs a part on a worker. Returns the worker's build and the records."""
    return build(), analysis.study(**asked, shard=shard).records


def parts(asked: dict[str, Any]) -> list[analysis.Study]:
    """Runs a study as tasks of one processor each, and returns its parts."""
    try:
        import ray
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("engine=\"ray\" needs Ray: pip install 'r4[ray]'", name="ray") from error
    if not ray.is_initialized():
        ray.init()
    processors = int(ray.cluster_resources().get("CPU", 1))  # type: ignore[no-untyped-call]
    # At most one part per seed, so that no part is empty.
    count = max(1, min(asked["seeds"], PARTS_PER_CPU * processors))
    task = ray.remote(run_part).options(
        # Without end: a part is run again for lost workers only. An exception of the study itself ends it at once.
        max_retries=-1,
        retry_exceptions=False,
        num_cpus=1,
        runtime_env={"env_vars": {"RAYON_NUM_THREADS": "1"}},
    )
    done = ray.get([task.remote(asked, f"{part}/{count}") for part in range(1, count + 1)])
    if different := {worker for worker, _ in done} - {build()}:
        raise NotStudied(
            f"{len(different)} other build(s) of r4 run on the cluster: install the same wheel on all machines"
        )
    return [analysis.Study([], records) for _, records in done]
