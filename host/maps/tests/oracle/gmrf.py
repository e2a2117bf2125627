"""Writes gmrf.json: a Gauss-Markov random field on a grid with walls, solved by GTSAM.

    python3 -m venv /tmp/oracle-gmrf && /tmp/oracle-gmrf/bin/pip install gtsam==4.3.0 numpy==2.4.6
    /tmp/oracle-gmrf/bin/python host/maps/tests/oracle/gmrf.py

A factor for each edge between free neighbours, each reading and each cell's prior; GTSAM eliminates them by multifrontal QR. Inputs are
sampled from a fixed seed.
"""

import importlib.metadata
import json
import pathlib

import gtsam
import numpy as np

rng = np.random.default_rng(14)
cases = []
for columns, rows, readings, smoothness, reading, prior in [(8, 8, 6, 0.5, 10.0, 1e-2), (30, 25, 40, 0.5, 0.5, 1e-3), (40, 30, 60, 0.5, 10.0, 1e-4)]:
    free = np.ones((rows, columns), bool)
    free[rows // 3, 1 : columns - 2] = False
    free[2 * rows // 3, 3:] = False
    cells = [(c, r) for r in range(rows) for c in range(columns) if free[r, c]]
    key = {cell: index for index, cell in enumerate(cells)}
    taken = [[*cells[i], float(v)] for i, v in zip(rng.integers(0, len(cells), readings), rng.uniform(0, 80, readings))]
    graph = gtsam.GaussianFactorGraph()
    unit = gtsam.noiseModel.Unit.Create(1)
    one = np.eye(1)
    for c, r in cells:
        i = key[c, r]
        graph.add(i, np.sqrt(prior) * one, np.zeros(1), unit)
        for near in [(c + 1, r), (c, r + 1)]:
            if near in key:
                graph.add(i, np.sqrt(smoothness) * one, key[near], -np.sqrt(smoothness) * one, np.zeros(1), unit)
    for c, r, value in taken:
        graph.add(key[c, r], np.sqrt(reading) * one, np.array([np.sqrt(reading) * value]), unit)
    solution = graph.optimize()
    tree = graph.eliminateMultifrontal()
    cases.append(
        {
            "columns": columns,
            "rows": rows,
            "free": free.ravel().tolist(),
            "smoothness": smoothness,
            "reading": reading,
            "prior": prior,
            "readings": taken,
            "mean": [float(solution.at(i)[0]) for i in range(len(cells))],
            "variance": [float(tree.marginalCovariance(i)[0, 0]) for i in range(len(cells))],
        }
    )

made = {"versions": {"gtsam": importlib.metadata.version("gtsam"), "numpy": np.__version__}, "fields": cases}
(pathlib.Path(__file__).parent / "gmrf.json").write_text(json.dumps(made) + "\n")
