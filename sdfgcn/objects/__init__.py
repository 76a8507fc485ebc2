"""The object catalogue: where objects come from, their shape, mass and resting poses."""
