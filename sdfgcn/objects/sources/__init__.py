"""Where objects come from: each module here registers a source of that name."""
