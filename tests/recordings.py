"""Recordings, read back."""

from rerun.chunk import RrdReader


class Recording:
    """A recording read back: for each entity and component, values by push (None is static).

    `motion` has those of the other timeline by seconds.
    """

    def __init__(self, path):
        reader = RrdReader(path)
        self.applications = {entry.application_id for entry in reader.recordings()}
        self.blueprints = {entry.application_id for entry in reader.blueprints()}
        self.timelines, self.values, self.motion = set(), {}, {}
        for chunk in reader.store().stream():
            self.timelines |= set(chunk.timeline_names)
            batch = chunk.to_record_batch().to_pydict()
            pushes = batch.get("push", [None] * chunk.num_rows)
            seconds = [time.total_seconds() for time in batch.get("motion", ())]
            for component in batch.keys() - {"push", "motion", "rerun.controls.RowId"}:
                of_pushes = pushes if "push" in batch or not seconds else ()
                for rows, times in ((self.values, of_pushes), (self.motion, seconds)):
                    cells = zip(times, batch[component], strict=False)
                    found = {time: cell for time, cell in cells if cell is not None}
                    if found:
                        rows.setdefault((chunk.entity_path, component), {}).update(found)

    def __getitem__(self, key):
        return self.values[key]

    def entities(self):
        return {entity for entity, _ in self.values}

    def pushes(self, entity):
        found = [rows.keys() for (path, _), rows in self.values.items() if path == entity]
        return sorted(set().union(*found) - {None})
