"""Writes oracle.json: Gaussian-process regression by scikit-learn.

    python3 -m venv /tmp/oracle-maps && /tmp/oracle-maps/bin/pip install scikit-learn==1.7.2 numpy==2.4.6 scipy==1.17.1
    /tmp/oracle-maps/bin/python host/maps/tests/oracle/oracle.py

Inputs are sampled from a fixed seed. The kernel of place and time is a sum of two kernels that see some of the columns; scikit-learn has
none, so one is made of its RBF and Matern(1/2) kernels. The parts of the mean follow from the whole's weights (alpha_).
"""

import json
import pathlib

import numpy as np
import sklearn
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, Kernel, Matern


class PlaceAndTime(Kernel):
    def __init__(self, s_s, l, s_t, tau):
        self.s_s, self.l, self.s_t, self.tau = s_s, l, s_t, tau

    def place(self, a, b=None):
        return self.s_s**2 * RBF(self.l)(a[:, :2], None if b is None else b[:, :2])

    def time(self, a, b=None):
        return self.s_t**2 * Matern(self.tau, nu=0.5)(a[:, 2:], None if b is None else b[:, 2:])

    def __call__(self, a, b=None, eval_gradient=False):
        return self.place(a, b) + self.time(a, b)

    def diag(self, a):
        return np.full(len(a), self.s_s**2 + self.s_t**2)

    def is_stationary(self):
        return True


rng = np.random.default_rng(21)
cases = []
for n, s_s, l, s_t, tau, s_n in [(12, 2.0, 3.0, 1.0, 50.0, 0.1), (60, 15.0, 4.0, 20.0, 200.0, 1.0), (30, 0.5, 0.7, 3.0, 9.0, 0.3)]:
    x = np.column_stack([rng.uniform(0, 10, (n, 2)), np.sort(rng.uniform(0, 300, n))])
    y = 5 * np.sin(x[:, 0] / 2) + 0.02 * x[:, 2] + rng.normal(0, s_n, n)
    kernel = PlaceAndTime(s_s, l, s_t, tau)
    model = GaussianProcessRegressor(kernel, alpha=s_n**2, optimizer=None).fit(x, y)
    at = np.column_stack([rng.uniform(0, 10, (8, 2)), rng.uniform(0, 400, 8)])
    mean, deviation = model.predict(at, return_std=True)
    inverse = np.linalg.inv(kernel(x) + s_n**2 * np.eye(n))

    def part(of, prior):
        k = of(at, x)
        return {"mean": (k @ model.alpha_).tolist(), "variance": (prior - np.einsum("ij,jk,ik->i", k, inverse, k)).tolist()}

    cases.append(
        {
            "kernel": {"s_s": s_s, "l": l, "s_t": s_t, "tau": tau, "s_n": s_n},
            "x": x.tolist(),
            "y": y.tolist(),
            "at": at.tolist(),
            "whole": {"mean": mean.tolist(), "variance": (deviation**2).tolist()},
            "place": part(kernel.place, s_s**2),
            "time": part(kernel.time, s_t**2),
            "log_likelihood": model.log_marginal_likelihood_value_,
        }
    )

made = {"versions": {"scikit-learn": sklearn.__version__, "numpy": np.__version__}, "regression": cases}
(pathlib.Path(__file__).parent / "oracle.json").write_text(json.dumps(made, indent=1) + "\n")
