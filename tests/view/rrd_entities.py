"""Reads a Rerun recording back into arrays."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rerun.chunk import Chunk, RrdReader

from handctl.log.read.reader import RunLog
from handctl.view.scene.run_info import RunInfo


class Entity(NamedTuple):
    """Rows of one entity.

    Attributes:
        times: run time of each row [ns]; empty if it is static.
        rows: component -> value of each row.
        static: component -> the value that holds at all times.
    """

    times: NDArray[np.int64]
    rows: dict[str, list[Any]]
    static: dict[str, Any]

    def table(self, component: str) -> NDArray[np.float64]:
        """(rows, instances) of a component."""
        return np.array(self.rows[component], float)


def entities(chunks: Iterable[Chunk]) -> dict[str, Entity]:
    """All that is in these chunks, rows in the order of time."""
    found: dict[str, Entity] = {}
    for chunk in chunks:
        one = found.setdefault(chunk.entity_path, Entity(np.empty(0, np.int64), {}, {}))
        batch = chunk.to_record_batch()
        kinds = {field.name: (field.metadata or {}).get(b"rerun:kind") for field in batch.schema}
        data = {name: batch.column(name).to_pylist() for name, kind in kinds.items() if kind == b"data"}
        if not chunk.timeline_names:
            one.static.update({name: values[-1] for name, values in data.items()})
            continue
        assert chunk.timeline_names == ["run_time"]
        times = np.asarray(batch.column("run_time").cast(pa.int64()))
        for name in one.rows.keys() | data.keys():
            missing = [None] * (len(times) if name not in data else 0)
            before = one.rows.setdefault(name, [None] * len(one.times))
            before += data.get(name, missing)
        found[chunk.entity_path] = one._replace(times=np.concatenate([one.times, times]))
    return {path: _sorted(one) for path, one in found.items()}


def _sorted(one: Entity) -> Entity:
    order = np.argsort(one.times, kind="stable")
    rows = {name: [values[i] for i in order] for name, values in one.rows.items()}
    return Entity(one.times[order], rows, one.static)


def of_file(path: Path) -> dict[str, Entity]:
    """All that is in a recording."""
    return entities(RrdReader(path).stream())


def subject_of(path: Path) -> RunInfo:
    """What a log shows."""
    with RunLog(path) as log:
        return RunInfo.of(log.header, path.stem)
