"""Tests of recordings, identification and studies."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import r4


def test_a_session_is_recorded_and_read_as_arrays(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with r4.sim("osmc-bench", seed=7, log=path).blocking as board:
        board.arm()
        end = board.osmc[0].move_to(1.0)
        board.estop()
        board.run_for(0.1)
    log = r4.read_log(path)
    assert (log.board, log.robot, log.seed, log.warnings) == ("sim:osmc-bench", "osmc-bench", 7, [])
    position = log["osmc0.position_rad"]
    assert position.value.dtype == position.time_s.dtype == np.float64 and position.kind == "continuous"
    assert len(position.value) == len(position.time_s) > 50
    # Sent every 10 ms; the time is that of the control period, 1 ms, in which the position was measured.
    np.testing.assert_allclose(np.diff(position.time_s), 0.01, atol=1.001e-3)
    np.testing.assert_allclose(np.diff(position.time_s).mean(), 0.01, atol=1e-3 / len(position.time_s))
    assert abs(position.value - end.position).min() < 1e-9
    assert list(log["state"].value)[-1] == "tripped"
    assert set(log["osmc0.settled"].value) == {0.0, 1.0}
    with pytest.raises(r4.BadFile, match="none.mcap"):
        r4.read_log(tmp_path / "none.mcap")
    (tmp_path / "bad.mcap").write_bytes(b"no log")
    with pytest.raises(r4.BadFile):
        r4.read_log(tmp_path / "bad.mcap")


def motor(path: Path, seed: int, friction_n_m: float) -> Path:
    """Recording at 100 Hz of a motor with a friction that the model lacks, by the equations written here."""
    random = np.random.default_rng(seed)
    inertia, damping, torque_constant, resistance, supply_v = 2e-4, 1e-4, 0.05, 1.0, 12.0
    speed, angle, rows = 0.0, 0.0, ["time_s,duty,theta_rad"]
    duty, steps = 0.0, 40
    for sample in range(2000):
        if sample % 50 == 0:
            duty = random.uniform(-0.6, 0.6)
        rows.append(f"{sample * 0.01:.2f},{duty:.6f},{angle + random.normal(0.0, 1e-3):.6f}")
        for _ in range(steps):
            torque = torque_constant * (duty * supply_v - torque_constant * speed) / resistance - damping * speed
            slowed = torque - math.copysign(friction_n_m, speed if abs(speed) > 1e-3 else torque)
            if abs(speed) <= 1e-3 and abs(torque) <= friction_n_m:
                speed = 0.0
            else:
                speed += slowed / inertia * 0.01 / steps
            angle += speed * 0.01 / steps
    path.write_text("\n".join(rows) + "\n")
    return path


def test_friction_that_the_model_lacks_is_found(tmp_path: Path) -> None:
    train, test = motor(tmp_path / "train.csv", 1, 0.04), motor(tmp_path / "test.csv", 2, 0.04)
    columns = {"input": "duty", "output": "theta_rad"}
    found = r4.identify(train, test, "dc-motor", columns, parameters={"supply_v": 12.0})
    assert any("coulomb" in effect for effect in found.effects), found.verdict
    before, after = found.report["baseline"]["holdout"]["rmse"], found.report["final"]["holdout"]["rmse"]
    assert after < before / 5.0
    assert found.plant is not None and "coulomb" in found.plant


def test_questions_that_make_no_sense(tmp_path: Path) -> None:
    file = motor(tmp_path / "a.csv", 1, 0.0)
    with pytest.raises(r4.NotIdentified, match="no model is called none; there are"):
        r4.identify(file, "every:2", "none")
    with pytest.raises(r4.NotIdentified, match="has no role `yaw`"):
        r4.identify(file, "every:2", "dc-motor", {"yaw": "duty"})
    with pytest.raises(r4.NotIdentified, match="both to fit to and to test on"):
        r4.identify(file, file, "dc-motor", {"input": "duty", "output": "theta_rad"})
    assert "dc-motor" in [model["name"] for model in r4.models()]


def test_a_study_is_rows_with_intervals() -> None:
    study = r4.study("skidcal", arms=["paper"], first_seed=1, seeds=2)
    assert study.rows and len(study.records) == 2
    for row in study.rows:
        assert row["system"] == "skidcal" and row["arm"] == "paper" and row["lo"] <= row["value"] <= row["hi"]
    parts = [r4.study("skidcal", arms=["paper"], first_seed=1, seeds=2, shard=shard) for shard in ("2/2", "1/2")]
    assert [len(part.records) for part in parts] == [1, 1] and not parts[0].rows
    assert r4.merge(parts) == study
    with pytest.raises(r4.NotStudied, match="is there twice"):
        other = r4.Study([], [{**study.records[0], "values": {}}])
        r4.merge([study, other])
    with pytest.raises(r4.NotStudied, match="skidcal"):
        r4.study("skidcal", arms=["none"])
    assert "skidcal" in r4.systems()
