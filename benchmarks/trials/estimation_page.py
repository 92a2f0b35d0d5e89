"""The section of ``docs/control.md`` on the tension estimate, and its picture."""

import numpy as np

from trials.page import FIGURES, table

COLUMNS = ("estimate", "raw", "raw now", "average", "cell alone", "limit", "limit now")
RATIOS = ("estimate / limit", "estimate / raw", "estimate / raw now", "nis", "whiteness")
ASKED_LIMIT, ASKED_NIS = 1.3, (0.8, 1.3)


def section(result: dict) -> str:
    """Markdown of a result of ``estimation.measure``."""
    parts = ["## The tension estimate", ""]
    few, many = min(result["seeds"].values()), max(result["seeds"].values())
    parts.append(
        "`python benchmarks/estimation.py --page`. RMSE of the tension at the load cell [N], all tendons, against the "
        f"plant. Seeds: {many if few == many else f'{few} to {many}'}. *raw* is the load cell against the instant at "
        "which it was read, *raw now* the same as a value for the present, one period later, which is what the "
        "estimate is judged by; *average* and *cell alone* are the best exponential average and the best filter on the "
        "load cell alone, both chosen with hindsight. *limit* is the Riccati bound of a fixed noise model "
        "(motor 10 mN m, joint 5 mN m, offset unknown, cell drift), without the period of delay that the estimate has "
        "to bridge; *limit now* is with it. NIS is per "
        "degree of freedom; 1 is right."
    )
    for hand, plants in result["hands"].items():
        rows = [[regime, *(f"{row[c]:.2f}" for c in COLUMNS + RATIOS)] for regime, row in plants["as known"].items()]
        parts += ["", table([hand, *COLUMNS, *RATIOS], rows)]
        others = [plant for plant in plants if plant != "as known"]
        if others:
            regimes = [regime for regime in ("free", "reversal", "impact", "hold") if regime in plants["as known"]]
            head = [f"{hand}, wrong plant", *[f"{r}: N (/ raw)" for r in regimes], "NIS free", "NIS hold"]
            parts += ["", table(head, [_wrong(plant, plants[plant], regimes) for plant in others])]
    parts += ["", _conclusion(result), "", "![Tension errors by regime](figures/control-estimation.png)"]
    return "\n".join(parts)


def _wrong(plant: str, found: dict, regimes: list[str]) -> list[str]:
    cells = [f"{found[r]['estimate']:.2f} ({found[r]['estimate / raw']:.2f})" for r in regimes]
    return [plant, *cells, f"{found['free']['nis']:.2f}", f"{found['hold']['nis']:.2f}"]


def _conclusion(result: dict) -> str:
    """What a reader should conclude, from the numbers."""
    met, missed = [], []
    for hand, plants in result["hands"].items():
        for regime in ("free", "hold"):
            row = plants["as known"].get(regime)
            if row is None:
                continue
            ratio, nis = row["estimate / limit"], row["nis"]
            good = ratio <= ASKED_LIMIT and ASKED_NIS[0] <= nis <= ASKED_NIS[1]
            (met if good else missed).append(f"{hand} {regime} ({ratio:.2f} times the limit, NIS {nis:.2f})")
    above = [
        f"{hand} {regime} ({row['estimate / raw']:.2f})"
        for hand, plants in result["hands"].items()
        for regime, row in plants["as known"].items()
        if row["estimate / raw"] > 1.0
    ]
    worst = max(
        (plants[plant][regime]["estimate / raw"], f"{hand}, {plant}, {regime}")
        for hand, plants in result["hands"].items()
        for plant in plants
        for regime in ("free", "hold")
        if plant.startswith("stiffness") and regime in plants[plant]
    )
    text = f"Asked for: within {ASKED_LIMIT} times the limit and NIS within {ASKED_NIS[0]} and {ASKED_NIS[1]}. "
    text += f"Kept: {'; '.join(met) or 'nowhere'}. " + (f"Not kept: {'; '.join(missed)}. " if missed else "")
    text += f"With the stiffness wrong by 20 % the worst is {worst[0]:.2f} times the raw cell ({worst[1]}). "
    if above:
        text += f"Worse than the raw cell: {'; '.join(above)}. "
    return text + (
        "As a value for the present, a period later, the cell itself is worse, too (*raw now*). What the estimate "
        "makes of the present includes one period of delay, at 200 Hz 5 ms: *limit now* is the bound of that; jamia11 "
        "stays near it. Where a digit turns, friction takes the tension from one edge of its band to the other; the "
        "filter is told how, from the cable's own speed. At an impact the first two samples decide, and a filter that "
        "averages is late. While the rope is taut nothing can tell the cell's error from tension: a bias is in the "
        "estimate as it is in the cell, and is found only when the rope hangs loose. The best average and the best "
        "filter on the cell alone are chosen for each regime with hindsight, so that one of them wins here and there."
    )


def picture(result: dict) -> None:
    """Bars by regime."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    hands = result["hands"]
    figure, axes = plt.subplots(1, len(hands), figsize=(4.6 * len(hands), 3.4), sharey=True, squeeze=False)
    ways = {"raw now": "#bbbbbb", "average": "#ccbb44", "cell alone": "#66ccee", "estimate": "#4477aa"}
    for axis, (hand, plants) in zip(axes[0], hands.items(), strict=True):
        found = plants["as known"]
        places = np.arange(len(found))
        for i, (way, colour) in enumerate(ways.items()):
            values = [row[way] for row in found.values()]
            axis.bar(places + 0.2 * (i - 1.5), values, 0.2, color=colour, label=way)
        limits = [row["limit"] for row in found.values()]
        axis.hlines(limits, places - 0.4, places + 0.4, color="#222222", label="limit")
        axis.set_xticks(places, list(found), rotation=20)
        axis.set_title(hand)
    axes[0][0].set_ylabel("RMSE of tension [N]")
    axes[0][-1].legend(fontsize=8, loc="upper left", ncols=2)
    axes[0][0].set_ylim(top=0.9)
    figure.tight_layout()
    FIGURES.mkdir(exist_ok=True)
    figure.savefig(FIGURES / "control-estimation.png", dpi=110)
