"""Draw every object of a catalogue in one picture.

`python -m sdfgcn.objects.contact_sheet objects=scanned out=contact_sheet.png` takes the same
overrides as the `sdfgcn` command; `pieces=true` draws collision pieces instead of meshes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
from hydra.errors import HydraException
from numpy.typing import NDArray
from omegaconf.errors import OmegaConfBaseException
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from sdfgcn.compose import load_config
from sdfgcn.config import SPLITS, ObjectsConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import replaced
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.objects.model import ObjectModel

TILE = 200  # pixels, side of one object's picture
CAPTION = 46  # pixels, height of the caption below it
COLUMNS = 8


def draw_sheet(cfg: ObjectsConfig, pieces: bool = False) -> Image.Image:
    """Draw all objects of both splits in their most probable resting pose.

    The caption gives each object's name, category, split, size, mass and number of rests. With
    `pieces`, the convex collision pieces are drawn instead of the mesh, each in its own colour.
    """
    models = [model for split in SPLITS for model in load_catalogue(cfg, split)]
    rows = -(-len(models) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * TILE, rows * (TILE + CAPTION)), "white")
    for index, model in enumerate(tqdm(models, desc="Drawing", unit="object", disable=None)):
        corner = (index % COLUMNS * TILE, index // COLUMNS * (TILE + CAPTION))
        sheet.paste(Image.fromarray(_picture(model, cfg.palette, index, pieces)), corner)
        text = ImageDraw.Draw(sheet)
        text.text((corner[0] + 4, corner[1] + TILE + 2), _caption(model), fill="black")
    return sheet


def _caption(model: ObjectModel) -> str:
    resting = Rotation.from_quat(model.rests[0].quat, scalar_first=True).apply(model.vertices)
    size = "x".join(f"{100 * side:.1f}" for side in np.ptp(resting, axis=0))
    return (
        f"{model.name}\n{model.category} ({model.split})\n"
        f"{size} cm, {1000 * model.mass:.0f} g, {len(model.rests)} rests"
    )


def _picture(
    model: ObjectModel, palette: list[list[float]], index: int, pieces: bool
) -> NDArray[np.uint8]:
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth = spec.visual.global_.offheight = TILE
    spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
    floor = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    floor.rgba = [0.75, 0.75, 0.72, 1]
    spec.worldbody.add_light(pos=[0.2, -0.3, 1.0], dir=[-0.2, 0.3, -1.0])
    rest = model.rests[0]
    body = spec.worldbody.add_body(pos=[0, 0, rest.height], quat=rest.quat)
    if pieces:
        for number, piece in enumerate(model.pieces):
            spec.add_mesh(name=f"piece{number}", uservert=piece.astype(float).ravel().tolist())
            colour = palette[number % len(palette)]
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"piece{number}", rgba=[*colour, 1]
            )
    else:
        _add_visual(spec, body, model, palette[index % len(palette)])
    return _rendered(spec.compile())


def _add_visual(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, model: ObjectModel, colour: list[float]
) -> None:
    mesh = spec.add_mesh(
        name="visual",
        uservert=model.vertices.astype(float).ravel().tolist(),
        userface=model.faces.ravel().tolist(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="visual", rgba=[*colour, 1])
    if model.texture is None or model.uv is None:
        return
    mesh.usertexcoord = model.uv.astype(float).ravel().tolist()
    texture = spec.add_texture(
        name="skin",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=model.texture.shape[1],
        height=model.texture.shape[0],
        nchannel=3,
    )
    texture.data = model.texture.tobytes()
    material = spec.add_material(name="skin")
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "skin"
    geom.material = "skin"
    geom.rgba = [1, 1, 1, 1]


def _rendered(model: mujoco.MjModel) -> NDArray[np.uint8]:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = [0, 0, 0.02]
    camera.distance, camera.azimuth, camera.elevation = 0.24, 60, -40
    with mujoco.Renderer(model, TILE, TILE) as renderer:
        renderer.update_scene(data, camera)
        return renderer.render()


def main(arguments: list[str]) -> int:
    """Draw the sheet requested on the command line; return the exit code."""
    if {"-h", "--help"} & set(arguments):
        print(__doc__)
        return 0
    own = dict(a.split("=", 1) for a in arguments if a.startswith(("out=", "pieces=")))
    out = Path(own.get("out", "contact_sheet.png"))
    overrides = [a for a in arguments if not a.startswith(("out=", "pieces="))]
    try:
        if not out.name:
            raise SdfgcnError("out is empty, but must be a file to write, such as sheet.png.")
        if own.get("pieces", "false") not in ("true", "false"):
            raise SdfgcnError(f"pieces is '{own['pieces']}', but must be true or false.")
        config = load_config(*overrides)
        sheet = draw_sheet(config.env.objects, pieces=own.get("pieces", "false") == "true")
        with replaced(out) as part:
            sheet.save(part, format="PNG")
    except (SdfgcnError, HydraException, OmegaConfBaseException, OSError) as error:
        print(str(error).splitlines()[0], file=sys.stderr)
        return 1
    print(f"Wrote {out}.")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
