"""The dataclasses of `env` in the config: the task and everything it depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from omegaconf import MISSING

from sdfgcn.config.base import (
    SPLITS,
    ComponentConfig,
    below_one,
    check_ranges,
    colour,
    colours,
    interval,
    number,
    one_of,
    positive,
    ranged,
    several,
    vector,
)
from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config


@dataclass
class ObjectsConfig(ComponentConfig):
    """The object catalogue (`conf/objects/`)."""

    footprint_min: float = positive(1)
    footprint_max: float = positive(1)
    height_max: float = positive(1)
    thickness_min: float = positive(1)
    mass_min: float = number(1e-6, 100)
    mass_max: float = number(1e-6, 100)
    density: float = positive(30_000)
    max_faces: int = number(100, 1_000_000)
    max_pieces: int = number(1, 1000)
    max_piece_vertices: int = number(8, 1000)
    texture_size: int = number(1, 4096)
    settle_drops: int = number(1, 10_000)
    settle_seconds: float = positive(60)
    settle_speed: float = positive(1)
    settle_friction: list[float] = vector(3, 0, 10)
    settle_min_probability: float = below_one()
    settle_min_tilt: float = number(0, 90)
    palette: list[list[float]] = colours()

    def check(self, config: Config) -> None:
        """See `check_limits`, which needs no other part of the config."""
        self.check_limits()

    def check_limits(self) -> None:
        """Check the limits, each alone and against each other.

        Raises:
            SdfgcnError: One sentence that names the key, its value and what would work.
        """
        check_ranges(self, "env.objects")
        for low, high in (("footprint_min", "footprint_max"), ("mass_min", "mass_max")):
            smallest, largest = getattr(self, low), getattr(self, high)
            if smallest >= largest:
                raise SdfgcnError(
                    f"env.objects.{low} is {smallest} and env.objects.{high} is {largest}, but the "
                    "first must be below the second."
                )


@dataclass
class RobotConfig(ComponentConfig):
    """The robot that executes the push (`conf/robot/`)."""

    home: list[float] = several(-10, 10)
    lead: float = number(0, 10)
    acceleration: float = number(0.01, 1000)


@dataclass
class ScenarioConfig(ComponentConfig):
    """How start and goal layouts are drawn (`conf/scenario/`)."""

    spacing: float = number(0, 5)
    gap: float = number(0, 5)
    max_tries: int = number(1, 100_000)


@dataclass
class ArenaConfig:
    """Table, camera and the regions on the table (`conf/env/`)."""

    spawn_x: list[float] = interval(-2, 2)
    spawn_y: list[float] = interval(-2, 2)
    range_x: list[float] = interval(-2, 2)
    range_y: list[float] = interval(-2, 2)
    reach_x: list[float] = interval(-2, 2)
    reach_y: list[float] = interval(-2, 2)
    table_rgba: list[float] = colour(4)
    camera_tilt: float = number(0, 75)
    camera_fovy: float = number(1, 150)
    camera_distance: float = number(0.4, 10)
    camera_target: list[float] = vector(2, -2, 2)
    image_size: int = number(8, 1024)


@dataclass
class PhysicsConfig:
    """MuJoCo options and contact parameters (`conf/env/`)."""

    timestep: float = number(1e-4, 0.05)
    cone: str = one_of("elliptic", "pyramidal")
    impratio: float = number(0.01, 100)
    ccd_tolerance: float = number(1e-9, 0.01)
    sliding_friction: float = number(0, 10)
    rolling_friction: float = number(0, 1)
    solref: list[float] = vector(2, 1e-4, 10)
    sleep_tolerance: float = number(0, 1)
    settle_seconds: float = number(0, 60)
    noslip_iterations: int = number(0, 1000)


@dataclass
class PushConfig:
    """The push primitive (`conf/env/`)."""

    directions: int = ranged(
        lambda value: 4 <= value <= 128 and value % 2 == 0, "must be an even number from 4 to 128"
    )
    length: float = positive(1)
    length_from: str = one_of("start", "surface", "touch")
    clearance: float = number(0, 0.2)
    search_step: float = number(1e-4, 0.1)
    height: float = number(0, 0.1)
    approach: float = number(0.01, 0.5)
    speed: float = number(0.001, 10)
    acceleration: float = number(0.01, 1000)
    descent_speed: float = number(0.001, 10)
    retreat: float = number(0, 0.5)
    lift_speed: float = number(0.001, 10)
    control_timestep: float = number(1e-4, 0.5)
    waypoint_spacing: float = number(0.001, 1)
    plane_height: float = number(0, 0.1)


@dataclass
class RewardConfig:
    """Reward terms (`conf/reward/`; paper section IV d and the authors' code)."""

    name: str = MISSING
    progress: float = number(-1e6, 1e6)
    step: float = number(-1e6, 1e6)
    floor: float | None = number(-1e6, 1e6)
    success: float = number(-1e6, 1e6)
    out_of_range: float = number(-1e6, 1e6)
    vanished: float = number(-1e6, 1e6)
    none_left: float = number(-1e6, 1e6)


@dataclass
class EncoderConfig(ComponentConfig):
    """The features by which objects are matched (`conf/encoder/`)."""

    stages: list[int] = several(1, 100)
    patch: float = number(0.02, 1)
    input_size: int = number(32, 512)
    rotations: int = number(1, 360)
    color_weight: float = number(0, 1000)
    camera_tilt: float = number(0, 75)


@dataclass
class SegmentationConfig(ComponentConfig):
    """How masks are found in a picture (`conf/segmentation/`)."""


@dataclass
class PerceptionConfig(ComponentConfig):
    """From a picture to masks and SDFs (`conf/perception/`)."""

    min_pixels: int = number(1, 1_000_000)
    sdf: str = one_of("fmm", "edt")
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)


@dataclass
class WorldConfig(ComponentConfig):
    """The world: a simulation or a real table (`conf/world/`)."""


@dataclass
class EnvConfig:
    """The task and everything it depends on (`conf/env/`)."""

    name: str = MISSING
    n_objects: int = number(1, 100)
    max_objects: int = number(1, 100)
    split: str = one_of(*SPLITS)
    pushes_per_object: int = number(1, 100_000)
    success_threshold: float = positive(10)
    pixels: bool = MISSING
    arena: ArenaConfig = field(default_factory=ArenaConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    push: PushConfig = field(default_factory=PushConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    world: WorldConfig = field(default_factory=WorldConfig)
    objects: ObjectsConfig = field(default_factory=ObjectsConfig)
    robot: RobotConfig = field(default_factory=RobotConfig)
    scenario: ScenarioConfig = field(default_factory=ScenarioConfig)
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
