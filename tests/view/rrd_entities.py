"""Read Rerun recordings into arrays."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rerun.chunk import Chunk, RrdReader

from handctl.log.read.reader import RunLog
from handctl.view.scene.run_info import RunInfo


class RecordingEntity(NamedTuple):
    """Data of one entity of a Rerun recording.

    Attributes:
        times: time of each row in the time of the run [ns]. For a static entity, the array of times
            is empty.
        rows: values of each component in all rows, by the name of the component.
        static_values: constant value of each static component, by the name of the component.
    """

    times: NDArray[np.int64]
    rows: dict[str, list[Any]]
    static_values: dict[str, Any]

    def table(self, component_name: str) -> NDArray[np.float64]:
        """Return the values of a component in all rows of the entity. The shape of the result is (rows, instances)."""
        return np.array(self.rows[component_name], float)


def read_entities(chunks: Iterable[Chunk]) -> dict[str, RecordingEntity]:
    """Return all entities in the given chunks of a recording.

    The rows of an entity are in the order of time.
    """
    entities_by_path: dict[str, RecordingEntity] = {}
    for chunk in chunks:
        entity = entities_by_path.setdefault(
            chunk.entity_path, RecordingEntity(np.empty(0, np.int64), {}, {})
        )
        batch = chunk.to_record_batch()
        kinds = {field.name: (field.metadata or {}).get(b"rerun:kind") for field in batch.schema}
        data = {
            name: batch.column(name).to_pylist() for name, kind in kinds.items() if kind == b"data"
        }
        if not chunk.timeline_names:
            entity.static_values.update({name: values[-1] for name, values in data.items()})
            continue
        assert chunk.timeline_names == ["run_time"]
        times = np.asarray(batch.column("run_time").cast(pa.int64()))
        for name in entity.rows.keys() | data.keys():
            missing = [None] * (len(times) if name not in data else 0)
            values_before = entity.rows.setdefault(name, [None] * len(entity.times))
            values_before += data.get(name, missing)
        entities_by_path[chunk.entity_path] = entity._replace(
            times=np.concatenate([entity.times, times])
        )
    return {path: _sorted_by_time(entity) for path, entity in entities_by_path.items()}


def _sorted_by_time(entity: RecordingEntity) -> RecordingEntity:
    order = np.argsort(entity.times, kind="stable")
    rows = {name: [values[i] for i in order] for name, values in entity.rows.items()}
    return RecordingEntity(entity.times[order], rows, entity.static_values)


def entities_of_file(recording_path: Path) -> dict[str, RecordingEntity]:
    """Return all entities in the file of a recording."""
    return read_entities(RrdReader(recording_path).stream())


def run_info_of(log_path: Path) -> RunInfo:
    """Read the header of a log, and return the data that the viewer needs about the run and the hand."""
    with RunLog(log_path) as log:
        return RunInfo.from_header(log.header, log_path.stem)
