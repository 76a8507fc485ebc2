"""Object sources; each module registers a source of the same name."""
