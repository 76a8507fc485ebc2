"""The simulated world: arena, robot, props, placement, push and task."""
