"""The task and everything it stands on: the dataclasses below `env` in the config."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from omegaconf import MISSING

from sdfgcn.config.base import ComponentConfig, check_above_zero, check_at_least
from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config


@dataclass
class ObjectsConfig(ComponentConfig):
    """Which object catalogue stands on the table (`conf/objects/`)."""

    footprint_min: float = MISSING
    footprint_max: float = MISSING
    height_max: float = MISSING
    thickness_min: float = MISSING
    mass_min: float = MISSING
    mass_max: float = MISSING
    density: float = MISSING
    max_faces: int = MISSING
    max_pieces: int = MISSING
    max_piece_vertices: int = MISSING
    texture_size: int = MISSING
    settle_drops: int = MISSING
    settle_seconds: float = MISSING
    settle_speed: float = MISSING
    settle_friction: list[float] = MISSING
    settle_min_probability: float = MISSING
    settle_min_tilt: float = MISSING
    palette: list[list[float]] = MISSING

    def check(self, config: Config) -> None:
        """See `check_limits`, which needs nothing else of the config."""
        self.check_limits()

    def check_limits(self) -> None:
        """Check the catalogue's limits, alone and against each other.

        Raises:
            SdfgcnError: One sentence that names the key, the value seen and what would work.
        """
        for low, high in (("footprint_min", "footprint_max"), ("mass_min", "mass_max")):
            smallest, largest = getattr(self, low), getattr(self, high)
            if not 0 < smallest < largest:
                raise SdfgcnError(
                    f"env.objects.{low} is {smallest} and env.objects.{high} is {largest}, but the "
                    f"first must be above 0 and below the second."
                )
        for key in ("height_max", "thickness_min", "density", "settle_seconds", "settle_speed"):
            value = getattr(self, key)
            if value <= 0:
                raise SdfgcnError(f"env.objects.{key} is {value}, but must be above 0.")
        for key, least in (
            ("max_faces", 100),
            ("max_pieces", 1),
            ("max_piece_vertices", 8),
            ("texture_size", 1),
            ("settle_drops", 1),
        ):
            value = getattr(self, key)
            if value < least:
                raise SdfgcnError(f"env.objects.{key} is {value}, but must be at least {least}.")
        if not 0 <= self.settle_min_probability < 1:
            raise SdfgcnError(
                f"env.objects.settle_min_probability is {self.settle_min_probability}, but must be "
                "at least 0 and below 1."
            )
        if len(self.settle_friction) != 3:
            raise SdfgcnError(
                f"env.objects.settle_friction is {self.settle_friction}, but must hold three "
                "numbers: sliding, torsional and rolling friction."
            )
        if not self.palette or not all(
            len(colour) == 3 and all(0 <= part <= 1 for part in colour) for colour in self.palette
        ):
            raise SdfgcnError(
                f"env.objects.palette is {self.palette}, but must list colours of three numbers "
                "between 0 and 1 (red, green, blue)."
            )


@dataclass
class RobotConfig(ComponentConfig):
    """What executes the push (`conf/robot/`)."""

    home: list[float] = MISSING
    lead: float = MISSING
    acceleration: float = MISSING

    def check(self, config: Config) -> None:
        """Check the tool's acceleration.

        Raises:
            SdfgcnError: See `ComponentConfig.check`.
        """
        check_above_zero({"env.robot.acceleration": self.acceleration})


@dataclass
class ScenarioConfig(ComponentConfig):
    """How start and goal layouts are drawn (`conf/scenario/`)."""

    spacing: float = MISSING
    gap: float = MISSING
    max_tries: int = MISSING


@dataclass
class ArenaConfig:
    """Table, light, camera and the regions on the table (`conf/env/`)."""

    spawn_x: list[float] = MISSING
    spawn_y: list[float] = MISSING
    range_x: list[float] = MISSING
    range_y: list[float] = MISSING
    reach_x: list[float] = MISSING
    reach_y: list[float] = MISSING
    table_rgba: list[float] = MISSING
    camera_tilt: float = MISSING
    camera_fovy: float = MISSING
    camera_distance: float = MISSING
    camera_target: list[float] = MISSING
    image_size: int = MISSING


@dataclass
class PhysicsConfig:
    """MuJoCo options and contact parameters (`conf/env/`)."""

    timestep: float = MISSING
    cone: str = MISSING
    impratio: float = MISSING
    ccd_tolerance: float = MISSING
    sliding_friction: float = MISSING
    rolling_friction: float = MISSING
    solref: list[float] = MISSING
    sleep_tolerance: float = MISSING
    settle_seconds: float = MISSING
    noslip_iterations: int = MISSING


@dataclass
class PushConfig:
    """The push primitive (`conf/env/`)."""

    directions: int = MISSING
    length: float = MISSING
    touch: bool = MISSING
    clearance: float = MISSING
    search_step: float = MISSING
    height: float = MISSING
    approach: float = MISSING
    speed: float = MISSING
    acceleration: float = MISSING
    descent_speed: float = MISSING
    retreat: float = MISSING
    lift_speed: float = MISSING
    control_timestep: float = MISSING
    waypoint_spacing: float = MISSING
    plane_height: float = MISSING


@dataclass
class RewardConfig:
    """Reward terms (`conf/env/`; paper section IV d and the authors' code)."""

    progress: float = MISSING
    step: float = MISSING
    floor: float = MISSING
    success: float = MISSING
    out_of_range: float = MISSING
    vanished: float = MISSING
    none_left: float = MISSING


@dataclass
class EncoderConfig(ComponentConfig):
    """What tells objects apart for matching (`conf/encoder/`)."""

    stages: list[int] = MISSING
    patch: float = MISSING
    input_size: int = MISSING
    rotations: int = MISSING
    color_weight: float = MISSING
    camera_tilt: float = MISSING

    def check(self, config: Config) -> None:
        """Check the numbers of the patches.

        Raises:
            SdfgcnError: See `ComponentConfig.check`.
        """
        if not 0 < self.patch <= 1:
            raise SdfgcnError(
                f"env.perception.encoder.patch is {self.patch}, but must be above 0 and at most 1."
            )
        check_at_least(32, {"env.perception.encoder.input_size": self.input_size})
        check_at_least(1, {"env.perception.encoder.rotations": self.rotations})
        check_at_least(0, {"env.perception.encoder.color_weight": self.color_weight})


@dataclass
class SegmentationConfig(ComponentConfig):
    """How masks are found in a picture (`conf/segmentation/`)."""


@dataclass
class PerceptionConfig(ComponentConfig):
    """Picture -> masks -> SDFs (`conf/perception/`)."""

    min_pixels: int = MISSING
    sdf: str = MISSING
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)


@dataclass
class WorldConfig(ComponentConfig):
    """Where the objects are: a simulation or a real table (`conf/world/`)."""


@dataclass
class EnvConfig:
    """The task and everything it stands on (`conf/env/`)."""

    name: str = MISSING
    n_objects: int = MISSING
    max_objects: int = MISSING
    split: str = MISSING
    pushes_per_object: int = MISSING
    success_threshold: float = MISSING
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
