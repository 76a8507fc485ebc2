"""Scenarios: a file for each option of the config group `scenario`."""
