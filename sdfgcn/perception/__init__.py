"""Perception: from pictures to object masks and signed distance fields."""
