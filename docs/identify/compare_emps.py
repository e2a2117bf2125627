"""Free-run errors on EMPS of the published model and of pysindy: the tables of comparison.md.

    python3 -m venv /tmp/compare
    /tmp/compare/bin/pip install pysindy==2.1.0 scikit-learn==1.9.1 numpy==2.4.6 scipy==1.17.1
    /tmp/compare/bin/python docs/identify/compare_emps.py

Everything is fitted to the training recording, and settings are selected by block cross-validation inside it. The held-out
recording is read last, and only simulated. All models have the form  acceleration = sum of coefficient * term(speed, force).
"""

import itertools
import pathlib

import numpy as np
import pysindy
from scipy import signal

DATA = pathlib.Path(__file__).resolve().parents[2] / "data" / "emps"
GAIN = 35.15065188  # N/V, published with the data
PERIOD = 1e-3  # s
SPEED, FORCE = 0.1, 100.0  # m/s and N: scales that make all terms of order 1, so that one threshold fits all of them
STRIBECK = 0.01  # m/s, speed at which the Stribeck term has decayed to 1/e
SHARPEST = 2e-4  # m/s: in a simulation, sign(v) is tanh(v / SHARPEST), which a Runge-Kutta step of 1 ms can follow
FOLDS = 5
PARSIMONY = 1.15  # the factor that `r4 identify` allows a named model over a curve

# Each is a function of speed, force and the smoothed sign of the speed.
TERMS = {
    "u": lambda v, f, s: f / FORCE,
    "1": lambda v, f, s: np.ones_like(v),
    "v": lambda v, f, s: v / SPEED,
    "sign v": lambda v, f, s: s,
    "|v|": lambda v, f, s: s * v / SPEED,
    "v|v|": lambda v, f, s: s * (v / SPEED) ** 2,
    "v^2": lambda v, f, s: (v / SPEED) ** 2,
    "v^3": lambda v, f, s: (v / SPEED) ** 3,
    "stribeck": lambda v, f, s: s * np.exp(-np.abs(v) / STRIBECK),
}
NAMES = list(TERMS)
WIDTHS = (0.0, 1e-3, 5e-3, 1e-2, 2e-2)  # m/s, of the smoothed sign
SIZES = {"strong": (20.0, 50.0, 100.0, 200.0), "weak": (0.1, 0.3, 1.0)}  # low-pass, Hz; half a test function, s
THRESHOLDS = (0.0, 0.01, 0.03, 0.1)
LIBRARIES = {"published": NAMES[:4], "direction": NAMES[:5], "friction curve": NAMES}


def read(name):
    """Position (m) and force (N)."""
    rows = np.genfromtxt(DATA / name, delimiter=",", names=True)
    return rows["q_meas_m"], GAIN * rows["u_V"]


def sign(v, width):
    return np.sign(v) if width == 0 else np.tanh(v / width)


def low_pass(x, cutoff_hz):
    """Without phase, as the authors' script does: Butterworth of order 4, forwards and backwards."""
    return signal.filtfilt(*signal.butter(4, cutoff_hz * 2 * PERIOD), x)


# Simulation: arrays of models at once, coefficients (models, terms), one force and one measured position for each.


def displacement(coefficients, widths, force, v):
    """Free run from speed v: the displacement after each sample. Runge-Kutta of order 4, force linear between samples."""
    widths = np.maximum(widths, SHARPEST)
    used = [(c, TERMS[n]) for n, c in zip(NAMES, coefficients.T) if c.any()]

    def acceleration(v, f):
        v = np.minimum(np.maximum(v, -1.0), 1.0)  # an unstable model must not overflow
        s = np.tanh(v / widths)
        return sum(c * term(v, f, s) for c, term in used)

    x, out = np.zeros_like(v), np.zeros(force.shape)
    for k in range(1, force.shape[1]):
        before, after = force[:, k - 1], force[:, k]
        a1 = acceleration(v, before)
        a2 = acceleration(v + PERIOD / 2 * a1, (before + after) / 2)
        a3 = acceleration(v + PERIOD / 2 * a2, (before + after) / 2)
        a4 = acceleration(v + PERIOD * a3, after)
        x = x + PERIOD * v + PERIOD**2 / 6 * (a1 + a2 + a3)
        v = v + PERIOD / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        out[:, k] = x
    return out


def free_run(coefficients, widths, force, measured, window):
    """Position over the whole recording; position and speed at its start are fitted to the first `window` samples."""
    models = len(coefficients)
    force, measured = (np.broadcast_to(x, (models, np.shape(x)[-1])) for x in (force, measured))
    part = measured[:, :window]

    def errors(v):
        e = part - displacement(coefficients, widths, force[:, :window], v)
        return e - e.mean(axis=1, keepdims=True)  # the best start position takes the mean

    best = part[:, :20] @ (np.arange(20) - 9.5) / (665 * PERIOD)  # slope of a line through 20 samples
    least = (errors(best) ** 2).sum(axis=1)
    for _ in range(6):  # Gauss-Newton in the start speed
        step = 1e-5
        e = errors(best)
        slope = (errors(best + step) - e) / step
        tried = best - (slope * e).sum(axis=1) / np.maximum((slope**2).sum(axis=1), 1e-30)
        cost = (errors(tried) ** 2).sum(axis=1)
        best, least = np.where(cost < least, tried, best), np.minimum(cost, least)
    out = displacement(coefficients, widths, force, best)
    return out + (part - out[:, :window]).mean(axis=1, keepdims=True)


# Identification.


def published_method(position, force, names):
    """Least squares on the inverse dynamic model, filtered and decimated as in the script published with the data."""
    q = low_pass(position, 100.0)
    v = np.gradient(q, PERIOD)
    a = np.gradient(v, PERIOD)
    columns = [a] + [TERMS[n](v, force, np.sign(v)) for n in names if n != "u"]
    keep = slice(50, -50)
    x, y = (signal.decimate(c[..., keep], 10, axis=-1) for c in (np.array(columns), force))
    mass, *rest = np.linalg.lstsq(x.T, y, rcond=None)[0]
    values = dict(zip(["u"] + [n for n in names if n != "u"], [FORCE / mass] + [-r / mass for r in rest]))
    return np.array([values.get(n, 0.0) for n in NAMES])


def output_error(position, force, names, coefficients):
    """Least squares of the free run over the whole recording, as output-error grey-box tools do: Gauss-Newton with halved steps."""
    free = [NAMES.index(n) for n in names]

    def errors(values):  # rows of values: coefficients, then the start speed
        c = np.zeros((len(values), len(NAMES)))
        c[:, free] = values[:, :-1]
        e = position - displacement(c, np.zeros(len(values)), np.broadcast_to(force, (len(values), len(force))), values[:, -1])
        return e - e.mean(axis=1, keepdims=True)

    best = np.append(coefficients[free], 0.0)
    for _ in range(20):
        step = np.diag(1e-4 * np.ones(len(best)))
        e, *moved = errors(np.vstack([best, best + step]))
        change = np.linalg.lstsq((np.array(moved) - e).T / 1e-4, -e, rcond=None)[0]
        tried = best + change * 0.5 ** np.arange(6)[:, None]
        costs = (errors(tried) ** 2).sum(axis=1)
        if costs.min() > (e**2).sum() * (1 - 1e-4):
            break
        best = tried[costs.argmin()]
    out = np.zeros(len(NAMES))
    out[free] = best[:-1]
    return out


def of_speed_and_force(term, width):
    # A closure, not a default argument: CustomLibrary counts arguments, defaults among them.
    return lambda v, f: term(v, f, sign(v, width))


def sindy(blocks, names, width, form, size, threshold):
    """Coefficients that pysindy finds on blocks of equal length; `size` is that of the test functions of the weak form."""
    speeds = [b[0] for b in blocks]
    forces = [b[1] for b in blocks]
    time = np.arange(len(speeds[0])) * blocks[0][2]
    library = pysindy.CustomLibrary([of_speed_and_force(TERMS[n], width) for n in names])
    if form == "weak":
        np.random.seed(1)  # places of the test functions
        library = pysindy.WeakPDELibrary(library, spatiotemporal_grid=time, H_xt=[size], K=200)
    model = pysindy.SINDy(pysindy.STLSQ(threshold=threshold, alpha=1e-6), library, pysindy.FiniteDifference(order=4))
    model.fit([s[:, None] for s in speeds], t=time, u=[f[:, None] for f in forces])
    found = dict(zip(names, model.coefficients()[0]))
    return np.array([found.get(n, 0.0) for n in NAMES])


def prepare(position, force, form, size):
    """Blocks of the training recording: speed and force, both filtered alike, and the period. `size` is what `select` says."""
    cutoff, every = (100.0 if form == "weak" else size), 2
    speed, force = np.gradient(low_pass(position, cutoff), PERIOD), low_pass(force, cutoff)
    length = len(position) // FOLDS
    parts = [slice(i * length, (i + 1) * length, every) for i in range(FOLDS)]
    return [(speed[part], force[part], PERIOD * every) for part in parts]


def select(position, force, form):
    """Two settings: the least RMSE of free runs over left-out blocks, and the fewest terms within a factor of PARSIMONY of it."""
    length = len(position) // FOLDS
    settings = list(itertools.product(("direction", "friction curve"), WIDTHS, SIZES[form], THRESHOLDS))
    blocks = {size: prepare(position, force, form, size) for size in SIZES[form]}
    widths = np.array([width for _, width, _, _ in settings])
    squares, terms = np.zeros(len(settings)), np.zeros(len(settings), int)
    for fold in range(FOLDS):
        coefficients = np.array(
            [
                sindy(blocks[size][:fold] + blocks[size][fold + 1 :], LIBRARIES[library], width, form, size, threshold)
                for library, width, size, threshold in settings
            ]
        )
        out = slice(fold * length, (fold + 1) * length)
        run = free_run(coefficients, widths, force[out], position[out], length // 10)
        squares += ((run - position[out]) ** 2).mean(axis=1) / FOLDS
        terms = np.maximum(terms, (coefficients != 0).sum(axis=1))
    rmse = np.sqrt(squares)
    fewest = terms[rmse <= PARSIMONY * rmse.min()].min()
    for chosen in (np.argmin(rmse), np.argmin(np.where(terms <= fewest, rmse, np.inf))):
        library, width, size, threshold = settings[chosen]
        print(f"{form}, at most {terms[chosen]} terms: {settings[chosen]}; cross-validation {rmse[chosen] * 1e3:.2f} mm")
        yield sindy(blocks[size], LIBRARIES[library], width, form, size, threshold), width


def main():
    position, force = read("train_trajectory.csv")
    authors = np.zeros(len(NAMES))
    mass, viscous, coulomb, offset = 95.1089, 203.5034, 20.3935, -3.1648
    authors[:4] = np.array([FORCE, -offset, -viscous * SPEED, -coulomb]) / mass
    models = [("published numbers", authors, 0.0)]
    for name in ("published", "direction"):
        start = published_method(position, force, LIBRARIES[name])
        models.append((f"inverse dynamic model, terms: {name}", start, 0.0))
        models.append((f"output error, terms: {name}", output_error(position, force, LIBRARIES[name], start), 0.0))
    for form in SIZES:
        for rule, (coefficients, width) in zip(("least error", "fewest terms"), select(position, force, form)):
            models.append((f"pysindy, {form} form, {rule}", coefficients, width))
    for name, c, _ in models:
        mass = FORCE / c[0]
        print(f"{name}: mass {mass:.4g} kg;", ", ".join(f"{n} {-x * mass:.4g} N" for n, x in zip(NAMES[1:], c[1:]) if x))

    measured, force = read("test_trajectory_with_pulses.csv")
    coefficients, widths = (np.array([m[i] for m in models]) for i in (1, 2))
    print(
        "\n| model | 20 samples: RMSE | MAE | NRMSE | first tenth: RMSE | MAE | NRMSE |\n| --- | --- | --- | --- | --- | --- | --- |"
    )
    cells = [[] for _ in models]
    for window, skipped in ((20, 20), (len(measured) // 10, 0)):
        runs = free_run(coefficients, widths, force, measured, window)
        for row, run in zip(cells, runs):
            e = (run - measured)[skipped:]
            rmse = np.sqrt(np.mean(e**2))
            row += [f"{rmse * 1e3:.2f}", f"{np.mean(np.abs(e)) * 1e3:.2f}", f"{100 * rmse / measured[skipped:].std():.2f} %"]
    for (name, *_), row in zip(models, cells):
        print(f"| {name} | " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
