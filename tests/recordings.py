"""Recordings, read back."""

from rerun.chunk import RrdReader


class Recording:
    """A recording read back: for each entity and component, values by push (None is static)."""

    def __init__(self, path):
        reader = RrdReader(path)
        self.applications = {entry.application_id for entry in reader.recordings()}
        self.blueprints = {entry.application_id for entry in reader.blueprints()}
        self.timelines, self.values = set(), {}
        for chunk in reader.store().stream():
            self.timelines |= set(chunk.timeline_names)
            batch = chunk.to_record_batch().to_pydict()
            pushes = batch.get("push", [None] * chunk.num_rows)
            for component in batch.keys() - {"push", "rerun.controls.RowId"}:
                rows = self.values.setdefault((chunk.entity_path, component), {})
                cells = zip(pushes, batch[component], strict=True)
                rows.update({push: cell for push, cell in cells if cell is not None})

    def __getitem__(self, key):
        return self.values[key]

    def entities(self):
        return {entity for entity, _ in self.values}

    def pushes(self, entity):
        found = [rows.keys() for (path, _), rows in self.values.items() if path == entity]
        return sorted(set().union(*found) - {None})
