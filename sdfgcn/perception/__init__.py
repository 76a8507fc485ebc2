"""Perception: from images to object masks and signed distance fields."""
