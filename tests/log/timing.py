"""Measure the cost of a log.

`python tests/log/timing.py` prints microseconds per tick on this machine, and checks no limit.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import synthetic

from handctl.log.read.reader import RunLog
from handctl.log.tick_record import RECORD_FRAMING_STRUCT, pack_tick_record
from handctl.log.write.recorder import Recorder
from handctl.log.write.writer import LogWriter


def _per_item(number: int, work: Callable[[], object]) -> float:
    """Return the processor time of some work per item [us], the best of three runs."""
    spent = []
    for _ in range(3):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return min(spent) / number * 1e6


def _written(path: Path, run: synthetic.RunHeader, bodies: list[bytes]) -> None:
    path.unlink(missing_ok=True)
    writer = LogWriter(path, run, print, 1)
    for body in bodies:
        writer.add_tick(body)
    writer.finish("finished", 0)


def main() -> None:
    """Measure the times to pack ticks, write a log, pass ticks through the pipe in lockstep, and read a log."""
    for hand, rate_hz in (("jamia", 500), ("jamia11", 1000)):
        run = synthetic.header(hand, rate_hz)
        ticks = list(synthetic.Synthetic(run, 10.0))
        number, records = len(ticks), [pack_tick_record(*tick) for tick in ticks]
        bodies = [record[RECORD_FRAMING_STRUCT.size :] for record in records]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.mcap"
            print(
                f"{hand} at {rate_hz} Hz, {len(records[9])} bytes and {_frames(ticks[9])} frames a tick"
            )
            packing = _per_item(
                number, lambda ticks=ticks: [pack_tick_record(*tick) for tick in ticks]
            )
            print(f"  pack            {packing:7.1f} us")
            writing = _per_item(
                number, lambda path=path, run=run, bodies=bodies: _written(path, run, bodies)
            )
            print(
                f"  write (child)   {writing:7.1f} us, {path.stat().st_size / number:.0f} bytes in the file"
            )
            print(
                f"  pipe, lockstep  {_lockstep(Path(folder) / 'b.mcap', run, records):7.1f} us wall time"
            )
            _read(path, number)


def _frames(tick: tuple[synthetic.TickIn, synthetic.TickOut]) -> int:
    return len(tick[0].frames) + len(tick[1].frames)


def _lockstep(path: Path, run: synthetic.RunHeader, records: list[bytes]) -> float:
    recorder = Recorder.start(path, run)
    start = time.perf_counter()
    for record in records:
        recorder.send_record(record)
        recorder.take_events()
    recorder.close("finished")
    return (time.perf_counter() - start) / len(records) * 1e6


def _read(path: Path, number: int) -> None:
    start = time.perf_counter()
    with RunLog(path) as log:
        log.field("tension")
        print(
            f"  open, one field {(time.perf_counter() - start) * 1e3:7.1f} ms for all {number} ticks"
        )
        start = time.perf_counter()
        for _ in log.ticks():
            pass
    print(f"  read ticks      {(time.perf_counter() - start) / number * 1e6:7.1f} us")


if __name__ == "__main__":
    main()
