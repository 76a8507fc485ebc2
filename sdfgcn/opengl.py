"""Early check that MuJoCo can render on this machine."""

from __future__ import annotations

import os
import subprocess
import sys

from sdfgcn.errors import SdfgcnError

_RENDER = """
from dm_control import mujoco
sphere = '<mujoco><worldbody><light/><geom type="sphere" size="1"/></worldbody></mujoco>'
mujoco.Physics.from_xml_string(sphere).render(8, 8)
"""


def check_opengl() -> None:
    """Render a small picture in a subprocess, since a bad driver may print, hang or crash.

    Raises:
        SdfgcnError: Rendering failed; the message says what to set.
    """
    try:
        subprocess.run([sys.executable, "-c", _RENDER], check=True, capture_output=True, timeout=60)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        raise SdfgcnError(
            f"OpenGL does not work with MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}; set "
            "MUJOCO_GL=egl (a GPU, or Mesa's libegl1) or MUJOCO_GL=osmesa (no GPU, libosmesa6)."
        ) from error
