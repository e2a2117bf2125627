"""Writes xrhmi_statsmodels.json: a study of ten synthetic people and what SciPy and statsmodels make of it.

    python3 -m venv /tmp/oracle && /tmp/oracle/bin/pip install scipy==1.17.1 numpy==2.4.6 statsmodels==0.15.0
    /tmp/oracle/bin/python host/systems/tests/oracle/xrhmi_statsmodels.py

The table is one as `r4 evaluate xrhmi --session` writes it, with other numbers than the program's own synthetic people.
"""

import csv
import io
import json
import pathlib

import numpy as np
import pandas as pd
import scipy
import statsmodels
import statsmodels.api as sm
import statsmodels.formula.api as smf
from scipy import stats
from statsmodels.stats.multitest import multipletests

MODALITIES = ["visual", "auditory", "haptic"]
PAIRS = [("haptic", "visual"), ("haptic", "auditory"), ("auditory", "visual")]
HEADER = ["participant", "place", "modality", "time_s", "mistakes", "timeouts", "status"] + [f"q{n}" for n in range(1, 11)]


def study(rng):
    """Rows of a table of trials; orders are sampled, not balanced."""
    for number in range(10):
        own = rng.normal(0.0, 4.0)
        for place, modality in enumerate(rng.permutation(3)):
            time_s = 38.0 + own + [0.0, 0.5, 5.0][modality] - 1.5 * place + rng.normal(0.0, 2.5)
            answers = np.clip(np.round(rng.normal([4.2, 4.1, 3.3][modality], 0.8, 10)), 1, 5).astype(int)
            answers[1::2] = 6 - answers[1::2]
            mistakes = int(rng.poisson([0.3, 0.4, 1.5][modality]))
            yield [f"P{number:03}", place + 1, MODALITIES[modality], f"{time_s:.6f}", mistakes, 0, "complete", *answers]


def score(row):
    answers = [row[f"q{n}"] for n in range(1, 11)]
    return 2.5 * (sum(answers[0::2]) - 5 + 25 - sum(answers[1::2]))


def compared(table, measure):
    value = table.pivot(index="participant", columns="modality", values=measure)
    place = table.pivot(index="participant", columns="modality", values="place")
    rows = []
    for first, second in PAIRS:
        difference = value[first] - value[second]
        fit = sm.OLS(difference, sm.add_constant(place[first] - place[second])).fit()
        welch = stats.ttest_ind(value[first], value[second], equal_var=False)
        # Exact with ties: by all signs.
        signs = stats.wilcoxon(
            difference[difference != 0], method=stats.PermutationMethod(n_resamples=1 << 13)
        )
        rows.append({
            "difference": fit.params.iloc[0],
            "interval": fit.conf_int().iloc[0].tolist(),
            "p": fit.pvalues.iloc[0],
            "per_place": fit.params.iloc[1],
            "per_place_p": fit.pvalues.iloc[1],
            "wilcoxon_p": signs.pvalue,
            "welch_t": welch.statistic,
            "welch_df": welch.df,
            "welch_p": welch.pvalue,
        })
    for row, p in zip(rows, multipletests([row["p"] for row in rows], method="holm")[1]):
        row["holm_p"] = p
    return rows


def main():
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(HEADER)
    writer.writerows(study(np.random.default_rng(17)))
    table = pd.read_csv(io.StringIO(text.getvalue()))
    table["sus"] = table.apply(score, axis=1)
    # For comparison only: a mixed model with a random person, which the program does not have.
    mixed = smf.mixedlm("time_s ~ C(modality, Treatment('haptic')) + place", table, groups=table["participant"]).fit()
    result = {
        "made_with": {"scipy": scipy.__version__, "statsmodels": statsmodels.__version__},
        "table": text.getvalue(),
        "mixed_visual": -mixed.params["C(modality, Treatment('haptic'))[T.visual]"],
        "mixed_visual_error": mixed.bse["C(modality, Treatment('haptic'))[T.visual]"],
        "measures": {measure: compared(table, measure) for measure in ["time_s", "mistakes", "sus"]},
    }
    path = pathlib.Path(__file__).with_suffix(".json")
    path.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
