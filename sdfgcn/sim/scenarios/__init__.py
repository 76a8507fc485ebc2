"""Scenarios, one module per option of the config group `scenario`."""
