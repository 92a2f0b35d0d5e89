"""Measure the CPU time that a log costs per tick.

`python tests/log/log_cpu_time.py` prints microseconds of CPU time per tick on the present machine.
The program checks no limits.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import synthetic_run

from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT
from handctl.log.write.log_writer import LogWriter
from handctl.log.write.recorder import Recorder


def _us_per_item(item_count: int, measured_work: Callable[[], object]) -> float:
    """Run a function three times, and return the shortest CPU time divided by ``item_count`` [us]."""
    times_s = []
    for _ in range(3):
        start = time.process_time()
        measured_work()
        times_s.append(time.process_time() - start)
    return min(times_s) / item_count * 1e6


def _write_log(
    log_path: Path, run_header: synthetic_run.RunHeader, tick_bodies: list[bytes]
) -> None:
    log_path.unlink(missing_ok=True)
    writer = LogWriter(log_path, run_header, print, 1)
    for body in tick_bodies:
        writer.add_tick(body)
    writer.finish("finished", 0)


def main() -> None:
    """Measure the CPU time per tick of four steps of recording.

    The four steps are: pack the ticks, write the log, send the ticks through the pipe to a recorder
    in lockstep, and read the log.
    """
    for hand, rate_hz in (("jamia", 500), ("jamia11", 1000)):
        run = synthetic_run.synthetic_header(hand, rate_hz)
        ticks = list(synthetic_run.SyntheticRunTicks(run, 10.0))
        tick_count, records = len(ticks), [pack_tick_record(*tick) for tick in ticks]
        bodies = [record[RECORD_FRAMING_STRUCT.size :] for record in records]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.mcap"
            print(
                f"{hand} at {rate_hz} Hz, {len(records[9])} bytes and {_frame_count(ticks[9])} frames a tick"
            )
            packing_us = _us_per_item(
                tick_count, lambda ticks=ticks: [pack_tick_record(*tick) for tick in ticks]
            )
            print(f"  pack            {packing_us:7.1f} us")
            writing_us = _us_per_item(
                tick_count, lambda path=path, run=run, bodies=bodies: _write_log(path, run, bodies)
            )
            print(
                f"  write (child)   {writing_us:7.1f} us, {path.stat().st_size / tick_count:.0f} bytes in the file"
            )
            print(
                f"  pipe, lockstep  {_lockstep_write_us(Path(folder) / 'b.mcap', run, records):7.1f} us wall time"
            )
            _print_read_time(path, tick_count)


def _frame_count(tick: tuple[synthetic_run.TickIn, synthetic_run.TickOut]) -> int:
    return len(tick[0].frames) + len(tick[1].frames)


def _lockstep_write_us(path: Path, run: synthetic_run.RunHeader, records: list[bytes]) -> float:
    recorder = Recorder.start(path, run)
    start = time.perf_counter()
    for record in records:
        recorder.send_record(record)
        recorder.take_events()
    recorder.close("finished")
    return (time.perf_counter() - start) / len(records) * 1e6


def _print_read_time(log_path: Path, tick_count: int) -> None:
    start = time.perf_counter()
    with RunLog(log_path) as log:
        log.field("tension")
        print(
            f"  open, one field {(time.perf_counter() - start) * 1e3:7.1f} ms for all {tick_count} ticks"
        )
        start = time.perf_counter()
        for _ in log.ticks():
            pass
    print(f"  read ticks      {(time.perf_counter() - start) / tick_count * 1e6:7.1f} us")


if __name__ == "__main__":
    main()
