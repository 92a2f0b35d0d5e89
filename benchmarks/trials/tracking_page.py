"""The section of ``docs/control.md`` on tracking, and its picture."""

import numpy as np

from trials.page import FIGURES, table

ENDED = "ended"
"""For a law with which safety ends at least one of the runs."""


def section(result: dict, named: tuple[str, str, str, str]) -> str:
    """Markdown of a result of ``tracking.measure``; ``named``: PD alone, springs and gravity, best, misprinted."""
    parts = ["## Tracking: what each part of the law is worth", ""]
    parts.append(
        "`python benchmarks/control.py --page` moves every digit from 0 to 60 degrees and back, with one thing more at "
        "each line. Error of the mean joint angle of each digit against the plant, RMSE during the motion with its "
        f"spread over the seeds ({result['seeds']}), all digits. The feedback weights of a law are the best of those "
        "tried (`--tune` tries all four); the stiffest were not tried with the force loops and, on jamia11, the full "
        "law, which therefore compare at weights half as stiff. *ended*: safety, or the controller itself, ended at "
        "least one run."
    )
    for hand, plants in result["hands"].items():
        laws = plants["as known"]
        speeds = list(next(iter(laws.values())))
        head = [hand, *[f"{speed} [deg]" for speed in speeds], "peak, fast", "steady", "settled after, at most 0.5 [s]"]
        rows = []
        for law, found in laws.items():
            fast = found["fast"]
            cells = [_cell(found[speed]) for speed in speeds]
            rows.append([law, *cells, *(_number(fast[k]) for k in ("peak_deg", "steady_deg", "settling_s"))])
        parts += ["", table(head, rows), "", _conclusion(hand, laws, named)]
        if len(plants) > 1:
            parts += ["", _wrong(hand, plants, named)]
    parts += ["", "![Tracking error at the fast motion, by law](figures/control-tracking.png)"]
    return "\n".join(parts)


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else ENDED


def _cell(row: dict[str, float]) -> str:
    finite = np.isfinite(row["rmse_deg"])
    return f"{row['rmse_deg']:.3f} ± {row['rmse_spread_deg']:.3f}" if finite else ENDED


def _conclusion(hand: str, laws: dict, named: tuple[str, str, str, str]) -> str:
    """What a reader should conclude, from the numbers."""
    plain, springs, best, printed = (laws[name]["fast"] for name in named)
    ratio, gain = plain["rmse_deg"] / best["rmse_deg"], springs["rmse_deg"] - best["rmse_deg"]
    spread = max(best["rmse_spread_deg"], springs["rmse_spread_deg"])
    better, old = [], laws[next(iter(laws))]["fast"]
    for law in list(laws)[1:-1]:
        new = laws[law]["fast"]
        if not np.isfinite(new["rmse_deg"]):
            better.append(f"with '{law}' safety or the controller itself ends a run")
            continue
        if new["rmse_deg"] >= old["rmse_deg"] - 2 * new["rmse_spread_deg"]:
            better.append(f"'{law}' brings nothing beyond the spread")
        old = new
    weak = f" Weak: {'; '.join(better)}." if better else ""
    misprint = printed["rmse_deg"] / best["rmse_deg"]
    cost = f"is {misprint:.1f} times worse" if np.isfinite(misprint) else "does not get to the end of a motion"
    verdict = "more" if ratio >= 5 else "less"
    return (
        f"At the fast motion the whole law tracks {ratio:.1f} times better than PD ({verdict} than the five times "
        f"asked for), and {gain:.2f} deg better than springs and gravity alone, "
        f"{gain / max(spread, 1e-9):.0f} times the spread. With Eq. 10-12 as printed the same law {cost}.{weak}"
    )


def _wrong(hand: str, plants: dict, named: tuple[str, str, str, str]) -> str:
    """Tracking where the plant is not as known."""
    head = [f"{hand}, fast, RMSE [deg]", named[0], named[2], "ratio"]
    rows = []
    for plant, laws in plants.items():
        plain, best = (laws[name]["fast"] for name in (named[0], named[2]))
        rows.append([plant, _cell(plain), _cell(best), _number(plain["rmse_deg"] / best["rmse_deg"])])
    return table(head, rows)


def picture(result: dict) -> None:
    """Bars of the fast motion."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    hands = result["hands"]
    figure, axes = plt.subplots(1, len(hands), figsize=(5.5 * len(hands), 3.6), sharey=True, squeeze=False)
    for axis, (hand, plants) in zip(axes[0], hands.items(), strict=True):
        laws = plants["as known"]
        mean = [found["fast"]["rmse_deg"] for found in laws.values()]
        spread = [found["fast"]["rmse_spread_deg"] for found in laws.values()]
        shown = [value if np.isfinite(value) else 0.0 for value in mean]
        spread = [value if np.isfinite(m) else 0.0 for value, m in zip(spread, mean, strict=True)]
        places = np.arange(len(laws))
        axis.barh(places, shown, xerr=np.nan_to_num(spread), color="#4477aa", ecolor="#222222", capsize=2)
        for place, value in zip(places, mean, strict=True):
            text = f"{value:.2f}" if np.isfinite(value) else ENDED
            axis.annotate(text, (value if np.isfinite(value) else 0.0, place), (6, -3), textcoords="offset points")
        axis.set_yticks(places, list(laws))
        axis.set_xlabel("RMSE, 0 to 60 deg in 0.15 s [deg]")
        axis.set_title(hand)
        axis.margins(x=0.15)
    axes[0][0].invert_yaxis()
    figure.tight_layout()
    FIGURES.mkdir(exist_ok=True)
    figure.savefig(FIGURES / "control-tracking.png", dpi=110)
