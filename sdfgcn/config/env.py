"""The dataclasses of `env` in the config: the task and everything it depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from omegaconf import MISSING

from sdfgcn.config.base import (
    SPLITS,
    ComponentConfig,
    at_least,
    below_one,
    check_ranges,
    fraction,
    interval,
    one_of,
    positive,
    ranged,
    vector,
)
from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config


@dataclass
class ObjectsConfig(ComponentConfig):
    """The object catalogue (`conf/objects/`)."""

    footprint_min: float = positive()
    footprint_max: float = positive()
    height_max: float = positive()
    thickness_min: float = positive()
    mass_min: float = positive()
    mass_max: float = positive()
    density: float = positive()
    max_faces: int = at_least(100)
    max_pieces: int = at_least(1)
    max_piece_vertices: int = at_least(8)
    texture_size: int = at_least(1)
    settle_drops: int = at_least(1)
    settle_seconds: float = positive()
    settle_speed: float = positive()
    settle_friction: list[float] = ranged(
        lambda value: len(value) == 3 and min(value) >= 0,
        "must hold three numbers from 0 on: sliding, torsional and rolling friction",
        whole=True,
    )
    settle_min_probability: float = below_one()
    settle_min_tilt: float = at_least(0)
    palette: list[list[float]] = ranged(
        lambda colours: (
            len(colours) > 0
            and all(len(colour) == 3 and 0 <= min(colour) <= max(colour) <= 1 for colour in colours)
        ),
        "must list colours of three numbers between 0 and 1 (red, green, blue)",
        whole=True,
    )

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

    home: list[float] = MISSING
    lead: float = at_least(0)
    acceleration: float = positive()


@dataclass
class ScenarioConfig(ComponentConfig):
    """How start and goal layouts are drawn (`conf/scenario/`)."""

    spacing: float = at_least(0)
    gap: float = at_least(0)
    max_tries: int = at_least(1)


@dataclass
class ArenaConfig:
    """Table, camera and the regions on the table (`conf/env/`)."""

    spawn_x: list[float] = interval()
    spawn_y: list[float] = interval()
    range_x: list[float] = interval()
    range_y: list[float] = interval()
    reach_x: list[float] = interval()
    reach_y: list[float] = interval()
    table_rgba: list[float] = fraction()
    camera_tilt: float = ranged(lambda value: 0 <= value < 90, "must be at least 0 and below 90")
    camera_fovy: float = ranged(lambda value: 0 < value < 180, "must be above 0 and below 180")
    camera_distance: float = positive()
    camera_target: list[float] = vector(2)
    image_size: int = at_least(1)


@dataclass
class PhysicsConfig:
    """MuJoCo options and contact parameters (`conf/env/`)."""

    timestep: float = positive()
    cone: str = one_of("elliptic", "pyramidal")
    impratio: float = positive()
    ccd_tolerance: float = positive()
    sliding_friction: float = at_least(0)
    rolling_friction: float = at_least(0)
    solref: list[float] = vector(2)
    sleep_tolerance: float = at_least(0)
    settle_seconds: float = at_least(0)
    noslip_iterations: int = at_least(0)


@dataclass
class PushConfig:
    """The push primitive (`conf/env/`)."""

    directions: int = ranged(
        lambda value: value >= 4 and value % 2 == 0, "must be an even number from 4 on"
    )
    length: float = positive()
    length_from: str = one_of("start", "surface", "touch")
    clearance: float = at_least(0)
    search_step: float = positive()
    height: float = at_least(0)
    approach: float = at_least(0)
    speed: float = positive()
    acceleration: float = positive()
    descent_speed: float = positive()
    retreat: float = at_least(0)
    lift_speed: float = positive()
    control_timestep: float = positive()
    waypoint_spacing: float = positive()
    plane_height: float = at_least(0)


@dataclass
class RewardConfig:
    """Reward terms (`conf/reward/`; paper section IV d and the authors' code)."""

    name: str = MISSING
    progress: float = MISSING
    step: float = MISSING
    floor: float | None = MISSING
    success: float = MISSING
    out_of_range: float = MISSING
    vanished: float = MISSING
    none_left: float = MISSING


@dataclass
class EncoderConfig(ComponentConfig):
    """The features by which objects are matched (`conf/encoder/`)."""

    stages: list[int] = at_least(1)
    patch: float = ranged(lambda value: 0 < value <= 1, "must be above 0 and at most 1")
    input_size: int = at_least(32)
    rotations: int = at_least(1)
    color_weight: float = at_least(0)
    camera_tilt: float = MISSING


@dataclass
class SegmentationConfig(ComponentConfig):
    """How masks are found in a picture (`conf/segmentation/`)."""


@dataclass
class PerceptionConfig(ComponentConfig):
    """From a picture to masks and SDFs (`conf/perception/`)."""

    min_pixels: int = at_least(0)
    sdf: str = MISSING
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)


@dataclass
class WorldConfig(ComponentConfig):
    """The world: a simulation or a real table (`conf/world/`)."""


@dataclass
class EnvConfig:
    """The task and everything it depends on (`conf/env/`)."""

    name: str = MISSING
    n_objects: int = MISSING
    max_objects: int = at_least(1)
    split: str = one_of(*SPLITS)
    pushes_per_object: int = at_least(1)
    success_threshold: float = at_least(0)
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
