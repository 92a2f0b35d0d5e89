"""The section of ``docs/evidence/control.md`` on the tension estimate, and its picture."""

import numpy as np

from trials.page import FIGURES, table

COLUMNS = {
    "then: filter": "filtered",
    "raw cell": "raw",
    "reference": "limit",
    "filter / reference": "filtered / limit",
    "filter / raw": "filtered / raw",
    "now: estimate": "estimate",
    "raw cell now": "raw now",
    "average": "average",
    "cell alone": "cell alone",
    "reference now": "limit now",
    "estimate / reference now": "estimate / limit now",
    "estimate / raw now": "estimate / raw now",
    "NIS": "nis",
    "whiteness": "whiteness",
}
"""Heads of the columns, and what stands in them."""
WRONG = ("filtered / raw", "estimate / raw now")
MAX_RATIO = 1.3
NIS_RANGE = (0.8, 1.3)


def section(result: dict) -> str:
    """Return the Markdown section of a result of ``estimation.measure``."""
    parts = ["## The tension estimate", ""]
    few = min(result["seeds"].values())
    many = max(result["seeds"].values())
    parts += [
        "`python benchmarks/estimation.py --page`. RMSE of the tension at the load cell [N], all tendons, against the "
        f"plant. Seeds: {many if few == many else f'{few} to {many}'}. A sample is one control period old when the "
        "controller uses it (2 ms on jamia, 5 ms on jamia11).",
        "",
        "- *then*: at the instant of the sample, the filter's value against the raw load cell.",
        "- *now*: at present, where the control loop needs the tension, the filter's prediction against the same "
        "sample.",
        "- *average* and *cell alone*: the best exponential average and the best filter on the load cell alone at "
        "present, both chosen with hindsight.",
        "- *reference*: the error of the filter that is optimal for a fixed noise model (motor 10 mN m, joint 5 mN m, "
        "offset unknown, cell drift). It is no bound. The simulated plant has less noise than that model where a digit "
        "moves freely, and the controller's filter knows the planned change of tension, so it may be below.",
        "- *NIS*: normalized innovation squared per degree of freedom, 1 is right.",
    ]
    for hand, plants in result["hands"].items():
        rows = [[regime, *(f"{row[c]:.2f}" for c in COLUMNS.values())] for regime, row in plants["as known"].items()]
        parts += ["", table([hand, *COLUMNS], rows)]
        others = [plant for plant in plants if plant != "as known"]
        if others:
            regimes = [r for r in ("free", "reversal", "impact", "hold", "slack") if r in plants["as known"]]
            columns = [f"{regime}: now, then and now / raw" for regime in regimes]
            head = [f"{hand}, wrong plant", *columns, "NIS free", "NIS hold"]
            parts += ["", table(head, [_wrong(plant, plants[plant], regimes) for plant in others])]
    parts += ["", _conclusion(result), "", "![Tension errors by regime](../figures/control-estimation.png)"]
    return "\n".join(parts)


def _wrong(plant: str, regimes_table: dict, regimes: list[str]) -> list[str]:
    cells = [
        f"{row['estimate']:.2f} N, {' and '.join(f'{row[ratio]:.2f}' for ratio in WRONG)}"
        for row in (regimes_table[regime] for regime in regimes)
    ]
    return [plant, *cells, f"{regimes_table['free']['nis']:.2f}", f"{regimes_table['hold']['nis']:.2f}"]


def _conclusion(result: dict) -> str:
    """Write the conclusion from the numbers."""
    met = []
    missed = []
    strict = []
    for hand, plants in result["hands"].items():
        for regime in [regime for regime in ("free", "hold") if regime in plants["as known"]]:
            row = plants["as known"][regime]
            ratio = row["filtered / limit"]
            nis = row["nis"]
            good = ratio <= MAX_RATIO and NIS_RANGE[0] <= nis <= NIS_RANGE[1]
            (met if good else missed).append(f"{hand} {regime} {ratio:.2f} times the reference, NIS {nis:.2f}")
            strict.append(f"{hand} {regime} {row['estimate / limit']:.2f}")
    text = f"Required: within {MAX_RATIO} times the reference, and NIS between {NIS_RANGE[0]} and {NIS_RANGE[1]}. "
    text += f"Met: {'; '.join(met) or 'nowhere'}. " + (f"Not met: {'; '.join(missed)}. " if missed else "")
    text += (
        "Relative to the reference without its delay, which is of another instant, the estimate for the present is "
        f"at {', '.join(strict)}. "
    )
    raw = "\n".join(f"- {_against_raw(result, ratio)}" for ratio in WHEN)
    parts = (text.strip(), "Comparison with the raw load cell:", raw, _otherwise_wrong(result), *EXPLANATION)
    return "\n\n".join(part for part in parts if part)


EXPLANATION = (
    "Both the prediction and the raw cell come from the same sample, which is one period old, and both are judged at "
    "present, because the control loop would use the raw sample as it is. While NIS shows that the model does not "
    "fit, the filter trusts its model less (`innovation.py`, `caution`).",
    "At a reversal friction takes the tension from one edge of its band to the other, and the filter gets this change "
    "from the tendon's own speed. At an impact the first two samples decide, and an averaging filter is late. There "
    "jamia11 gains least.",
    "While a tendon is taut no measurement distinguishes the cell's error from tension. A bias is in the estimate as "
    "it is in the cell, and is found only when the tendon is slack. The best average and the best filter on the cell "
    "alone are chosen for each regime with hindsight, so one of them is better in some regimes.",
)
WHEN = {
    "filtered / raw": "At the instant of the sample",
    "estimate / raw now": "At present",
    "estimate / raw": "With the cell at its own instant and the estimate at present",
}


def _against_raw(result: dict, ratio: str) -> str:
    """List the regimes in which the raw cell is better, for the plant as known and for wrong stiffness."""
    rows = [
        (row[ratio], f"{hand} {regime}, {plant}")
        for hand, plants in result["hands"].items()
        for plant, worse in plants.items()
        if plant == "as known" or plant.startswith("stiffness")
        for regime, row in worse.items()
    ]
    above = [f"{name} ({value:.2f})" for value, name in rows if value > 1.0]
    worst, name = max(rows)
    if not above:
        return (
            f"{WHEN[ratio]} the estimate is never worse than the raw cell, also with the stiffness off by up to 50 %. "
            f"The worst ratio is {worst:.2f} ({name})."
        )
    return f"{WHEN[ratio]} the estimate is worse than the raw cell in: {'; '.join(above)}."


def _otherwise_wrong(result: dict) -> str:
    """List the regimes in which the raw cell is better on plants with other wrong parameters."""
    rows = [
        (row["estimate / raw now"], row["nis"], f"{hand} {regime}, {plant}")
        for hand, plants in result["hands"].items()
        for plant, worse in plants.items()
        if plant != "as known" and not plant.startswith("stiffness")
        for regime, row in worse.items()
    ]
    if not rows:
        return ""
    above = [f"{name} ({value:.2f})" for value, _, name in rows if value > 1.0]
    nis, name = max((nis, name) for _, nis, name in rows)
    if not above:
        return "With mass, friction or the cell itself off the estimate is at present never worse than the raw cell."
    return (
        f"With other parameters off the estimate is at present worse than the raw cell in: {'; '.join(above)}. "
        f"The innovations show it (the largest NIS is {nis:.2f}, {name}), and `handctl identify` finds friction "
        "within some per cent."
    )


def picture(result: dict) -> None:
    """Draw bars by regime."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    hands = result["hands"]
    figure, axes = plt.subplots(1, len(hands), figsize=(4.6 * len(hands), 3.4), sharey=True, squeeze=False)
    ways = {
        "raw": "#dddddd",
        "filtered": "#88aadd",
        "raw now": "#bbbbbb",
        "average": "#ccbb44",
        "cell alone": "#66ccee",
        "estimate": "#4477aa",
    }
    for axis, (hand, plants) in zip(axes[0], hands.items(), strict=True):
        regimes_table = plants["as known"]
        places = np.arange(len(regimes_table))
        for i, (estimator, colour) in enumerate(ways.items()):
            values = [row[estimator] for row in regimes_table.values()]
            axis.bar(places + 0.14 * (i - 2.5), values, 0.14, color=colour, label=estimator)
        for key, style, where in (("limit", "-", -0.28), ("limit now", ":", 0.14)):
            limits = [row[key] for row in regimes_table.values()]
            name = key.replace("limit", "reference")
            axis.hlines(limits, places + where - 0.16, places + where + 0.3, "#222222", style, label=name)
        axis.set_xticks(places, list(regimes_table), rotation=20)
        axis.set_title(hand)
    axes[0][0].set_ylabel("RMSE of tension [N]")
    axes[0][-1].legend(fontsize=8, loc="upper left", ncols=2)
    axes[0][0].set_ylim(top=0.9)
    figure.tight_layout()
    FIGURES.mkdir(exist_ok=True)
    figure.savefig(FIGURES / "control-estimation.png", dpi=110)
