"""Writes oracle.json: inputs and what SciPy, NumPy and statsmodels make of them.

    python3 -m venv /tmp/oracle && /tmp/oracle/bin/pip install scipy==1.17.1 numpy==2.4.6 statsmodels==0.15.0
    /tmp/oracle/bin/python host/maths/tests/oracle/oracle.py

Inputs are sampled from fixed seeds, or published. The file names the versions it was made with.
"""

import json
import pathlib
import sys

import numpy as np
import scipy
import statsmodels
import statsmodels.api as sm
from scipy import interpolate, optimize, sparse, stats
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.power import TTestIndPower, TTestPower
from statsmodels.stats.proportion import proportion_confint

rng = np.random.default_rng(18)
ALTERNATIVES = {"two-sided": "TwoSided", "less": "Less", "greater": "Greater"}


def samples():
    """Named samples: normal, skewed, tied, with outliers, and with a large mean that cancels."""
    return {
        "normal": rng.normal(3.0, 2.0, 40).tolist(),
        "skewed": rng.lognormal(0.0, 1.0, 31).tolist(),
        "tied": rng.integers(0, 5, 24).astype(float).tolist(),
        "outliers": np.concatenate([rng.normal(0.0, 1.0, 20), [50.0, -80.0, 1e4]]).tolist(),
        "offset": (1e9 + rng.normal(0.0, 1.0, 25)).tolist(),
        "pair": [1.5, -2.25],
    }


def one_sample(values):
    x = np.array(values)
    return {
        "values": values,
        "mean": np.mean(x),
        "variance": np.var(x, ddof=1),
        "standard_error": stats.sem(x),
        "median": np.median(x),
        "mad": stats.median_abs_deviation(x),
        "robust_deviation": stats.median_abs_deviation(x, scale="normal"),
        "rms": np.sqrt(np.mean(x * x)),
        "mean_interval": stats.t.interval(0.9, len(x) - 1, np.mean(x), stats.sem(x)),
        "quantiles": [
            {
                "probability": p,
                "linear": np.quantile(x, p, method="linear"),
                "nearest_rank": np.quantile(x, p, method="inverted_cdf"),
            }
            for p in [0.0, 0.05, 0.25, 0.5, 0.6180339887, 0.9, 0.999, 1.0]
        ],
    }


def two_samples():
    for n, m, shift, spread in [(12, 15, 0.5, 3.0), (5, 60, 1.0, 0.2), (2, 3, 0.0, 1.0), (100, 100, 5.0, 1.0)]:
        a, b = rng.normal(0.0, 1.0, n), rng.normal(shift, spread, m)
        for name, ours in ALTERNATIVES.items():
            found = stats.ttest_ind(a, b, equal_var=False, alternative=name)
            yield {
                "a": a.tolist(),
                "b": b.tolist(),
                "alternative": ours,
                "t": found.statistic,
                "degrees_of_freedom": found.df,
                "p": found.pvalue,
            }


def signed_rank_p(a, b, alternative):
    """Exact also with ties: by all 2^n signs."""
    d = a - b
    d = d[d != 0]
    tied = len(np.unique(np.abs(d))) < len(d)
    if len(d) <= 50 and tied:
        assert len(d) <= 12
        return stats.wilcoxon(d, alternative=alternative, method=stats.PermutationMethod(n_resamples=1 << 13)).pvalue
    method = "exact" if len(d) <= 50 else "approx"
    return stats.wilcoxon(d, alternative=alternative, method=method, correction=False).pvalue


def pairs():
    yield from pairs_of(rng.normal(0.0, 1.0, 20), lambda a: a + rng.normal(0.3, 0.5, 20))
    yield from pairs_of(rng.normal(0.0, 1.0, 50), lambda a: a + rng.normal(0.1, 0.5, 50))
    # Ties and equal pairs; few enough for all signs.
    yield from pairs_of(rng.integers(0, 5, 12).astype(float), lambda a: a + rng.integers(-1, 3, 12))
    # Beyond what is counted: the normal approximation, with ties.
    yield from pairs_of(rng.integers(0, 9, 80).astype(float), lambda a: a + rng.integers(-4, 6, 80))
    yield from pairs_of(rng.normal(0.0, 1.0, 200), lambda a: a + rng.normal(0.1, 0.7, 200))


def pairs_of(a, other):
    b = other(a)
    for name, ours in ALTERNATIVES.items():
        t = stats.ttest_rel(a, b, alternative=name)
        yield {
            "a": a.tolist(),
            "b": b.tolist(),
            "alternative": ours,
            "t": t.statistic,
            "p_t": t.pvalue,
            "p_signed_rank": signed_rank_p(a, b, name),
        }


def errors():
    for n, scale in [(30, 0.3), (200, 4.0), (2, 1.0)]:
        measured = rng.normal(100.0, 1.0, n)
        predicted = measured + rng.normal(0.0, scale, n)
        rmse = np.sqrt(np.mean((measured - predicted) ** 2))
        yield {"measured": measured.tolist(), "predicted": predicted.tolist(), "rmse": rmse, "nrmse": rmse / np.std(measured)}


def wilson():
    for k, n in [(0, 1), (1, 1), (0, 10), (9, 10), (190, 200), (1, 100000), (500, 1000)]:
        for level in [0.5, 0.9, 0.95, 0.999]:
            low, high = proportion_confint(k, n, alpha=1 - level, method="wilson")
            yield {"successes": k, "trials": n, "level": level, "low": low, "high": high}


def mcnemars():
    for b, c in [(0, 1), (1, 4), (4, 1), (10, 10), (3, 20), (60, 100), (0, 40)]:
        yield {"only_first": b, "only_second": c, "p": mcnemar([[7, b], [c, 9]], exact=True).pvalue}


def bootstraps(data):
    statistics = {"mean": np.mean, "median": np.median, "deviation": lambda x, axis: np.std(x, ddof=1, axis=axis)}
    for sample, statistic, level in [
        ("skewed", "mean", 0.95),
        ("skewed", "deviation", 0.9),
        ("normal", "median", 0.95),
        ("normal", "mean", 0.99),
        ("outliers", "mean", 0.95),
    ]:
        x, f = np.array(data[sample]), statistics[statistic]

        def found(resamples, method, seed):
            generator = np.random.default_rng(seed)
            return stats.bootstrap(
                (x,), f, confidence_level=level, n_resamples=resamples, method=method, rng=generator
            )

        ends = lambda found: [found.confidence_interval.low, found.confidence_interval.high]
        few = [found(199, method, 5) for method in ["percentile", "BCa"]]
        # Of 20 seeds, so that the test knows how far an end may be off by chance.
        many = {method: [found(20000, method, seed) for seed in range(20)] for method in ["percentile", "BCa"]}
        spread = lambda method: np.std([ends(one) for one in many[method]], axis=0, ddof=1)
        middle = lambda method: np.mean([ends(one) for one in many[method]], axis=0)
        yield {
            "values": data[sample],
            "statistic": statistic,
            "level": level,
            "jackknife": [f(np.delete(x, i), axis=0) for i in range(len(x))],
            "distribution": few[0].bootstrap_distribution.tolist(),
            "percentile": ends(few[0]),
            "bca": ends(few[1]),
            "many": [{"ends": middle(method), "spread": spread(method)} for method in many],
            "standard_error": np.mean([one.standard_error for one in many["percentile"]]),
        }


def linear_fits():
    """Longley's data are the ill-conditioned example that NIST certifies regressions with."""
    data = sm.datasets.longley.load()
    design = np.column_stack([np.ones(len(data.endog)), np.array(data.exog)])
    yield linear_fit(design, np.array(data.endog), np.ones(len(data.endog)))
    x = np.linspace(-1.0, 2.0, 30)
    design = np.column_stack([np.ones(30), x, x**2, np.sin(3.0 * x)])
    deviations = rng.uniform(0.1, 2.0, 30)
    observed = design @ [1.0, -2.0, 0.5, 3.0] + deviations * rng.normal(0.0, 1.0, 30)
    yield linear_fit(design, observed, np.ones(30))
    yield linear_fit(design, observed, deviations)
    # Columns of very different scales, as of rad and of counts.
    design = np.column_stack([1e6 * rng.normal(0.0, 1.0, 12), 1e-6 * rng.normal(0.0, 1.0, 12)])
    yield linear_fit(design, design @ [2e-6, 3e6] + 0.01 * rng.normal(0.0, 1.0, 12), np.ones(12))


def linear_fit(design, observed, deviations):
    found = sm.WLS(observed, design, weights=deviations**-2.0).fit(method="qr")
    return {
        "design": design.tolist(),
        "observed": observed.tolist(),
        "deviations": deviations.tolist(),
        "parameters": found.params,
        "covariance": found.cov_params(),
        "lag": 3,
        "autocorrelated": found.get_robustcov_results("HAC", maxlags=3, use_correction=True).cov_params(),
        "residuals": found.resid,
        "residual_variance": found.scale,
        "intervals": found.conf_int(0.1),
        "p_values": found.pvalues,
        "level": 0.9,
    }


# NIST StRD, https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml (public domain), with its first or second start.
NIST = {
    "misra1a": (
        [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0],
        [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78],
        [500.0, 0.0001],
    ),
    "boxbod": ([1.0, 2.0, 3.0, 5.0, 7.0, 10.0], [109.0, 149.0, 149.0, 191.0, 213.0, 224.0], [100.0, 0.75]),
}


def nonlinear_fits():
    """Both models are b0 (1 - exp(-b1 x))."""
    model = lambda x, b0, b1: b0 * (1.0 - np.exp(-b1 * x))
    slopes = lambda x, b0, b1: np.column_stack([1.0 - np.exp(-b1 * x), b0 * x * np.exp(-b1 * x)])
    for name, (x, y, start) in NIST.items():
        found, covariance = optimize.curve_fit(
            model, np.array(x), np.array(y), p0=start, jac=slopes, xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        yield {"name": name, "x": x, "y": y, "start": start, "parameters": found, "covariance": covariance}


def splines():
    for periodic in [False, True]:
        for n in [2, 3, 4, 9]:
            knots = np.cumsum(rng.uniform(0.2, 2.0, n))
            values = rng.normal(0.0, 3.0, n)
            if n == 9:
                # A plateau and a turn, where PCHIP has slopes of 0.
                values[3] = values[4]
            x = np.linspace(knots[0], knots[-1], 41)
            found = {"knots": knots.tolist(), "values": values.tolist(), "x": x.tolist()}
            if periodic:
                # Parabolas through three knots round the circle: the slopes of three turns, of which the middle one counts.
                period = knots[-1] - knots[0] + 0.7
                around = np.concatenate([knots - period, knots, knots + period])
                bessel = interpolate.CubicHermiteSpline(around, np.tile(values, 3), slopes_of(around, np.tile(values, 3)))
                found["x"] = (knots[0] + np.linspace(-0.5, 1.5, 41) * period).tolist()
                inside = knots[0] + (np.array(found["x"]) - knots[0]) % period
                yield found | {"period": period, "bessel": bessel(inside)}
                continue
            natural = interpolate.CubicSpline(knots, values, bc_type="natural")
            pchip = interpolate.PchipInterpolator(knots, values)
            bessel = interpolate.CubicHermiteSpline(knots, values, slopes_of(knots, values))
            yield found | {
                "bessel": bessel(x),
                "natural": natural(x),
                "natural_slope": natural(x, 1),
                "monotone": pchip(x),
                "monotone_slope": pchip(x, 1),
            }


def slopes_of(knots, values):
    return np.gradient(values, knots, edge_order=min(2, len(knots) - 1))


# As in the tests, by name.
FUNCTIONS = {
    "cubic": (lambda x: x**3 - 2 * x - 5, 1.0, 3.0),
    "cosine": (lambda x: np.cos(x) - x, 0.0, 1.0),
    "steep": (lambda x: np.exp(20 * x) - 1e3, -1.0, 2.0),
    "flat": (lambda x: (x - 0.3) ** 9, -1.0, 1.2),
    "pole": (lambda x: 1.0 / (x - 4.0) + 1.0, 2.0, 3.5),
}


def roots():
    for name, (f, low, high) in FUNCTIONS.items():
        for tolerance in [1e-3, 1e-9]:
            root = optimize.brentq(f, low, high, xtol=1e-15, rtol=1e-15, maxiter=1000)
            yield {"name": name, "low": low, "high": high, "tolerance": tolerance, "root": root}


def minima():
    rosenbrock = lambda x: sum(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)
    for bounds, start in [([(-5, 5)] * 2, [-1.2, 1.0]), ([(-5, 0.5), (-5, 5)], [-1.2, 1.0]), ([(-2, 2)] * 3, [0.0, 0.5, 1.5])]:
        found = optimize.minimize(
            rosenbrock, start, bounds=bounds, method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-16, "maxfev": 5000}
        )
        assert found.success
        yield {"bounds": bounds, "start": start, "at": found.x, "value": found.fun}


def grids():
    """Shortest paths by csgraph, over the same steps: eight directions, no corner cut, mean factor of both cells."""
    for columns, rows, share in [(12, 9, 0.2), (30, 30, 0.35), (7, 40, 0.1)]:
        factors = np.where(rng.random((rows, columns)) < share, np.inf, rng.choice([1.0, 1.0, 2.0, 5.0], (rows, columns)))
        factors[0, 0] = factors[-1, -1] = 1.0
        graph = sparse.lil_array((rows * columns, rows * columns))
        for y in range(rows):
            for x in range(columns):
                for dx, dy in [(1, 0), (0, 1), (1, 1), (-1, 1)]:
                    if not (0 <= x + dx < columns and y + dy < rows):
                        continue
                    beside = max(factors[y, x + dx], factors[y + dy, x])
                    cost = np.hypot(dx, dy) * (factors[y, x] + factors[y + dy, x + dx]) / 2
                    if np.isfinite(cost) and (dx == 0 or dy == 0 or np.isfinite(beside)):
                        graph[y * columns + x, (y + dy) * columns + x + dx] = cost
        costs = sparse.csgraph.dijkstra(graph.tocsr(), directed=False, indices=0).reshape(rows, columns)
        encode = lambda table: [[None if np.isinf(value) else value for value in row] for row in table]
        yield {"factors": encode(factors), "costs": encode(costs)}


def kalman():
    """Position and speed from positions, by statsmodels."""
    step, steps = 0.1, 60
    transition = np.array([[1.0, step], [0.0, 1.0]])
    process = 0.3 * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    measured = np.cumsum(rng.normal(0.1, 0.05, steps)) + rng.normal(0.0, 0.2, steps)
    model = sm.tsa.statespace.MLEModel(measured, k_states=2)
    model["design"] = np.array([[1.0, 0.0]])
    model["obs_cov"] = np.array([[0.04]])
    model["transition"] = transition
    model["selection"] = np.eye(2)
    model["state_cov"] = process
    # statsmodels starts with the prediction for the first sample.
    model.ssm.initialize_known(np.zeros(2), np.diag([4.0, 1.0]))
    # Otherwise it stops updating the covariance when it has nearly converged.
    model.ssm.tolerance = 0
    found = model.ssm.filter()
    yield {
        "transition": transition,
        "process": process,
        "noise": 0.04,
        "start": [4.0, 1.0],
        "measured": measured,
        "states": found.filtered_state.T,
        "covariances": found.filtered_state_cov.T,
        "log_likelihoods": found.llf_obs,
    }


def powers():
    """Where SciPy's noncentral t is a number; far from 0 it is NaN."""
    for effect in [0.0, 0.2, 0.96, 1.02, -1.02, 2.5]:
        for n, m in [(2, 2), (10, 10), (17, 17), (5, 40), (40, 40)]:
            for level in [0.05, 0.05 / 3, 0.001]:
                two_sample = TTestIndPower().power(effect, n, level, ratio=m / n)
                paired = TTestPower().power(effect, n, level)
                if np.isfinite(two_sample) and np.isfinite(paired):
                    yield {
                        "effect": effect,
                        "counts": [n, m],
                        "level": level,
                        "two_sample": two_sample,
                        "paired": paired,
                    }


def corrections():
    for p in [[0.01, 0.04, 0.03], [0.5, 0.5, 0.9], [0.001], [0.02, 0.02, 0.02, 0.2], [0.0, 1.0], np.random.default_rng(7).uniform(size=12)]:
        yield {"p_values": list(p), "holm": multipletests(p, method="holm")[1].tolist()}


def plain(value):
    """Only what JSON has, numbers with all their digits."""
    if isinstance(value, dict):
        return {key: plain(other) for key, other in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(other) for other in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    return value


def main():
    data = samples()
    oracle = {
        "made_with": {
            "python": sys.version.split()[0],
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "statsmodels": statsmodels.__version__,
        },
        "one_sample": [one_sample(values) for values in data.values()],
        "welch": list(two_samples()),
        "paired": list(pairs()),
        "errors": list(errors()),
        "wilson": list(wilson()),
        "mcnemar": list(mcnemars()),
        "bootstrap": list(bootstraps(data)),
        "linear_fits": list(linear_fits()),
        "nonlinear_fits": list(nonlinear_fits()),
        "splines": list(splines()),
        "roots": list(roots()),
        "minima": list(minima()),
        "grids": list(grids()),
        "kalman": list(kalman()),
        "powers": list(powers()),
        "corrections": list(corrections()),
    }
    path = pathlib.Path(__file__).with_name("oracle.json")
    path.write_text(json.dumps(plain(oracle)) + "\n")


if __name__ == "__main__":
    main()
