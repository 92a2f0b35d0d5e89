"""Read a log into numpy arrays and a pandas data frame.

handctl demo --lockstep --log grasp.mcap
python read_log.py grasp.mcap
"""

import sys

import pandas as pd

from handctl.log.read.reader import RunLog

with RunLog(sys.argv[1]) as log:
    print(f"{len(log)} ticks of {log.header.period_ns / 1e6:g} ms, fields: {', '.join(log.fields)}")
    tension = log.field("tension")  # numpy array (ticks, tendons) [N]
    print("largest tension of each tendon [N]:", tension.max(axis=0).round(1))

    columns = {f"{field}/{name}": log.field(field)[:, i] for field in ("q", "tension", "tip_force")
               for i, name in enumerate(log.names(field))}  # fmt: skip
    table = pd.DataFrame(columns, index=pd.Index(log.times, name="t_s"))
    changes = {change.k: change.name for change in log.phases}
    table["phase"] = pd.Series(log.k, index=table.index).map(changes).ffill()
    for row in log.events:
        if row.event.name == "contact":
            print(f"{row.t_ns / 1e9:7.3f} s  {row.event.text}")

means = table.filter(like="tension").groupby(table["phase"], sort=False).mean()
print(means.round(1).to_string())
