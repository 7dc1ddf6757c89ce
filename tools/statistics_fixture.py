"""Writes tools/fixtures/statistics.json: what pingouin, statsmodels and scipy say of a few within-subjects data sets.

    pip install pingouin statsmodels scipy
    python tools/statistics_fixture.py

Rust's answers are compared with these in shared/experiments/src/anova.rs. pingouin gives the analysis of variance with
Greenhouse and Geisser's correction, statsmodels the same F and p again, scipy the t-tests and intervals.
"""

import itertools
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pingouin
import scipy
import statsmodels
from scipy import stats
from statsmodels.stats.anova import AnovaRM
from statsmodels.stats.multitest import multipletests


def interval(values):
    low, high = stats.t.interval(0.95, len(values) - 1, loc=np.mean(values), scale=stats.sem(values))
    return [float(np.mean(values)), float(low), float(high)]


def case(name, people):
    people = np.asarray(people, dtype=float)
    n, k = people.shape
    rows = [(i, j, people[i, j]) for i in range(n) for j in range(k)]
    table = pd.DataFrame(rows, columns=["person", "condition", "value"])
    anova = pingouin.rm_anova(
        data=table, dv="value", within="condition", subject="person", correction=True, detailed=True, effsize="np2"
    )
    effect, error = anova.iloc[0], anova.iloc[1]

    def pick(row, *names):
        return float(next(row[name] for name in names if name in row.index))

    f = pick(effect, "F")
    # pingouin rounds nothing but what it prints; statsmodels has to agree.
    other = AnovaRM(table, "value", "person", within=["condition"]).fit().anova_table.iloc[0]
    assert abs(other["F Value"] - f) < 1e-9 * abs(f)
    eps = pick(effect, "eps")
    df = (k - 1.0, (n - 1.0) * (k - 1.0))
    assert pick(effect, "DF") == df[0] and pick(error, "DF") == df[1]
    p = pick(effect, "p_unc", "p-unc")
    assert abs(other["Pr > F"] - p) < 1e-9 * p
    # With two conditions sphericity holds always, and pingouin leaves the corrected p away.
    corrected = float(stats.f.sf(f, df[0] * eps, df[1] * eps))
    if k > 2:
        theirs = pick(effect, "p_GG_corr", "p-GG-corr")
        assert abs(corrected - theirs) < 1e-9 * theirs
    eta = pick(effect, "np2")
    pairs = list(itertools.combinations(range(k), 2))
    tests = [stats.ttest_rel(people[:, a], people[:, b]) for a, b in pairs]
    adjusted = multipletests([t.pvalue for t in tests], method="bonferroni")[1]
    return {
        "name": name,
        "people": people.tolist(),
        "anova": [f, df[0], df[1], p, eps, corrected, eta],
        "pairs": [
            {
                "a": a,
                "b": b,
                "t": float(t.statistic),
                "p": float(t.pvalue),
                "p_bonferroni": float(q),
                "difference": interval(people[:, a] - people[:, b]),
            }
            for (a, b), t, q in zip(pairs, tests, adjusted)
        ],
        "intervals": [interval(people[:, j]) for j in range(k)],
    }


def main():
    rng = np.random.default_rng(20)
    person = rng.normal(0, 1, (21, 1))
    drive = np.clip(np.round(person + rng.normal([4, 3.5, 1.5, 1.6], [1.2, 1.0, 0.6, 0.7], (21, 4))), 0, 6)
    skewed = rng.normal(0, 1, (12, 3)) * [0.1, 1.0, 6.0] + [1, 1, 3]
    cases = [
        case("21 people, 4 conditions, counts", drive),
        case("12 people, 3 conditions, unequal variances", skewed),
        case("10 people, 2 conditions", rng.normal([0.0, 0.8], 1.0, (10, 2))),
        case("5 people, 6 conditions, no effect", rng.normal(50, 5, (5, 6))),
        case("21 people, 4 conditions, an enormous effect", person + rng.normal([0, 0, 9, 40], 0.5, (21, 4))),
    ]
    versions = {m.__name__: m.__version__ for m in (pingouin, statsmodels, scipy, np)}
    made_by = "tools/statistics_fixture.py with " + ", ".join(f"{k} {v}" for k, v in versions.items())
    path = Path(__file__).parent / "fixtures" / "statistics.json"
    path.write_text(json.dumps({"made_by": made_by, "cases": cases}, indent=1) + "\n")
    print(path, made_by)


if __name__ == "__main__":
    main()
