"""Set-up for all tests."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo loads: render without a display
