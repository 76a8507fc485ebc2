"""Robots that execute the push: a file for each option of the config group `robot`."""
