"""Send ticks to a recorder until the sending process is killed: `python tick_sender.py PATH`.

The program prints the number of each tick that the pipe to the recorder has accepted.
"""

import itertools
import os
import sys
import time
from pathlib import Path

import synthetic_run

from handctl.log.tick_packing import pack_tick_record
from handctl.log.write.recorder import Recorder


def main() -> None:
    """Record ticks without end, about one tick per millisecond."""
    run = synthetic_run.synthetic_header(rate_hz=1000, deterministic=False)
    ticks = list(synthetic_run.SyntheticRunTicks(run, 0.2))
    recorder = Recorder.start(Path(sys.argv[1]), run)
    for k in itertools.count():
        tick_in, out = ticks[k % len(ticks)]
        tick_in = tick_in._replace(k=k, t_ns=k * run.period_ns)
        if recorder.send_record(pack_tick_record(tick_in, out)):
            os.write(1, k.to_bytes(8, "little"))
        time.sleep(0.0005)


if __name__ == "__main__":
    main()
