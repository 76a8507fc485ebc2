"""The simulated world: arena, robot, props, placement, push and task."""

import warnings

with warnings.catch_warnings():
    # When it loads, it makes Python show every DeprecationWarning of every package.
    import dm_control.composer  # noqa: F401
