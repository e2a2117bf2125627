"""The batch files of docs/studies, run part by part in a shell as their schedulers would."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

EXAMPLES = Path(__file__).parents[3] / "docs" / "studies"
PROGRAM = os.environ.get("R4_PROGRAM", "")
PARTS, SEEDS, SYSTEM = 3, 2, "tail"

pytestmark = pytest.mark.skipif(not Path(PROGRAM).is_file(), reason="R4_PROGRAM names no built r4")


def environment(tmp_path: Path, **variables: object) -> dict[str, str]:
    """Returns this process' environment with the program as `r4` in its PATH."""
    programs = tmp_path / "bin"
    programs.mkdir(exist_ok=True)
    if not (programs / "r4").exists():
        (programs / "r4").symlink_to(Path(PROGRAM).resolve())
    path = f"{programs}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, **{name: str(value) for name, value in variables.items()}}


def merged(tmp_path: Path, parts: list[Path]) -> list[Any]:
    out = tmp_path / "all.jsonl"
    arguments = ["r4", "system", "merge", *map(str, parts), "--out", str(out)]
    # Its exit code says whether the system's targets are met, which so few trials do not decide.
    assert subprocess.run(arguments, env=environment(tmp_path), capture_output=True).returncode in (0, 1)
    return [json.loads(line) for line in out.read_text().splitlines()]


def whole(tmp_path: Path) -> list[Any]:
    out = tmp_path / "whole.jsonl"
    arguments = ["r4", "system", "study", SYSTEM, "--seeds", str(SEEDS), "--out", str(out)]
    assert subprocess.run(arguments, env=environment(tmp_path), capture_output=True).returncode in (0, 1)
    return [json.loads(line) for line in out.read_text().splitlines()]


def test_the_slurm_array(tmp_path: Path) -> None:
    script = EXAMPLES / "slurm.sbatch"
    assert subprocess.run(["bash", "-n", script]).returncode == 0
    for part in range(1, PARTS + 1):
        variables = environment(tmp_path, SLURM_ARRAY_TASK_ID=part, SLURM_ARRAY_TASK_COUNT=PARTS, SLURM_CPUS_PER_TASK=1)
        done = subprocess.run(["bash", script, SYSTEM, str(SEEDS)], cwd=tmp_path, env=variables, capture_output=True)
        assert done.returncode == 0, done.stderr.decode()
    lost = tmp_path / f"study-{SYSTEM}" / "part-0002.jsonl"
    before = lost.read_bytes()
    lost.unlink()
    # Alone again: the array then has one task, so that the number of parts is given.
    variables = environment(tmp_path, SLURM_ARRAY_TASK_ID=2, SLURM_ARRAY_TASK_COUNT=1)
    again = ["bash", script, SYSTEM, str(SEEDS), str(PARTS)]
    assert subprocess.run(again, cwd=tmp_path, env=variables, capture_output=True).returncode == 0
    assert lost.read_bytes() == before
    assert merged(tmp_path, sorted(lost.parent.glob("part-*.jsonl"))) == whole(tmp_path)


def test_a_slurm_script_outside_an_array_says_how_to_start_it(tmp_path: Path) -> None:
    alone = {name: value for name, value in environment(tmp_path).items() if not name.startswith("SLURM")}
    done = subprocess.run(
        ["bash", EXAMPLES / "slurm.sbatch", SYSTEM, "3"], cwd=tmp_path, env=alone, capture_output=True, text=True
    )
    assert done.returncode != 0 and "sbatch --array=1-PARTS" in done.stderr


def test_the_kubernetes_job(tmp_path: Path) -> None:
    job = yaml.safe_load((EXAMPLES / "kubernetes.yaml").read_text())
    assert (job["apiVersion"], job["kind"], job["spec"]["completionMode"]) == ("batch/v1", "Job", "Indexed")
    [container] = job["spec"]["template"]["spec"]["containers"]
    given = {variable["name"]: variable["value"] for variable in container["env"]}
    assert job["spec"]["completions"] == job["spec"]["parallelism"] == int(given["PARTS"])
    mounted = {mount["name"] for mount in container["volumeMounts"]}
    assert mounted == {volume["name"] for volume in job["spec"]["template"]["spec"]["volumes"]}
    few = {**given, "SYSTEM": SYSTEM, "SEEDS": str(SEEDS), "PARTS": str(PARTS)}
    for index in range(PARTS):
        variables = environment(tmp_path, JOB_COMPLETION_INDEX=index, **few)
        done = subprocess.run(container["command"], cwd=tmp_path, env=variables, capture_output=True)
        assert done.returncode == 0, done.stderr.decode()
    assert merged(tmp_path, sorted(tmp_path.glob("part-*.jsonl"))) == whole(tmp_path)
