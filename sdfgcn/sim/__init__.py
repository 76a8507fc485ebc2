"""The simulated world: arena, robots, props, placement, push and task."""

import warnings

with warnings.catch_warnings():
    # Importing dm_control makes Python show the DeprecationWarnings of all packages.
    import dm_control.composer  # noqa: F401
