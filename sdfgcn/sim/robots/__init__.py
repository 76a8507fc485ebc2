"""Robots that execute the push, one module per option of the config group `robot`."""
