"""Settings of a training run as frozen data; chosen by the experiments in docs/training.md."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from league.agents.network import NetworkConfig
from league.envs.actions import ActionSpace, ContinuousActions
from league.envs.config import RewardConfig
from league.errors import ConfigError
from league.sim.config import (
    CameraConfig,
    DynamicsRandomization,
    RaceKind,
    SensorConfig,
    VisualRandomization,
)


@dataclass(frozen=True)
class PpoConfig:
    """Proximal policy optimisation; two values are from the start to the end of the budget."""

    steps: int = 64
    """Steps of each row between two updates."""
    epochs: int = 6
    """Passes over what was collected."""
    mini_batches: int = 16
    """Parts of what was collected; each is one gradient step."""
    gamma: float = 0.95
    """Discount for each step (1/15 s)."""
    lam: float = 0.9
    """Generalised advantage estimation's lambda."""
    forgiving: bool = False
    """Whether a mistake costs what the reward takes for it, and no more. Else it also costs all
    that would have been earned after it: the farther the learner looks ahead, the farther it stays
    from the edge of the road."""
    clip: float = 0.2
    """Largest change of a decision's probability ratio that still counts."""
    learning_rate: tuple[float, float] = (3e-3, 3e-4)
    """Adam's step size, falling geometrically."""
    noise: tuple[float, float] = (0.4, 0.06)
    """Standard deviation of the exploration of continuous actions, falling geometrically."""
    pull: float = 0.1
    """How strongly means beyond [-1, 1] are pulled back; `Leashed` in models.py."""
    entropy: tuple[float, float] = (0.01, 0.0)
    """Weight of the entropy of discrete actions, falling linearly."""
    value_clip: bool = False
    """Whether the critic may move by clip only, as PPO2 did."""
    value_weight: float = 1.0
    """Weight of the critic's loss."""
    max_gradient: float = 1.0
    """Norm to which gradients are cut."""

    def __post_init__(self) -> None:
        for name in ("steps", "epochs", "mini_batches"):
            if getattr(self, name) < 1:
                raise ConfigError(f"PPO {name} is {getattr(self, name)}: give at least 1")
        for name in ("gamma", "lam"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"PPO {name} is {getattr(self, name)}: give 0 to 1")
        if not all(1e-8 <= rate <= 0.1 for rate in self.learning_rate):
            raise ConfigError(f"learning rates are {self.learning_rate}: give 1e-8 to 0.1")
        if not all(1e-3 <= noise <= 5 for noise in self.noise):
            raise ConfigError(f"exploration noise is {self.noise}: give 0.001 to 5")

    def refining(self) -> PpoConfig:
        """Return the settings for going on from a trained policy, which larger steps would spoil.

        Smaller ones yet keep its pace better, but it hardly learns to see what is new to it, say
        other cars (docs/training.md).
        """
        return replace(self, learning_rate=(2e-3, 3e-4), noise=(0.3, 0.05))

    def racing(self) -> PpoConfig:
        """Return the settings for racing others, where what pays comes later: a pass takes 1 s."""
        return replace(self, gamma=0.97)


@dataclass(frozen=True)
class TrainConfig:
    """Everything a training run needs but its tracks, its reward object and its opponents."""

    kind: RaceKind = "time_trial"
    """Kind of race to learn."""
    num_worlds: int = 64
    """Worlds in the batch."""
    num_cars: int = 1
    """Cars in each world; the others are opponents."""
    seed: int = 0
    """Seed of weights, worlds and exploration."""
    device: str = "cpu"
    """Where worlds and networks live."""
    action_space: ActionSpace = field(default_factory=ContinuousActions)
    """What the policy may ask for."""
    sensors: SensorConfig = field(
        default_factory=lambda: SensorConfig(camera=CameraConfig(width=64, height=48))
    )
    """What its car carries."""
    network: NetworkConfig = field(
        default_factory=lambda: NetworkConfig(strides=(4, 2, 1), activation="elu")
    )
    """Its layers."""
    critic_hidden: tuple[int, ...] = (128, 128)
    """Layers of the critic, which sees the true state."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """Weights of the built-in terms, unless a reward function is given."""
    tutor: float = 0.0
    """Share of the budget in which a driver that is told the truth learns first (tutor.py)."""
    ppo: PpoConfig = field(default_factory=PpoConfig)
    """The learner."""
    mirror: bool = True
    """Learn from every second mini-batch with left and right swapped, where actions allow it."""
    both_directions: bool = False
    """Drive the tracks in both directions."""
    looks: VisualRandomization | None = None
    """Randomised pictures."""
    spread: DynamicsRandomization | None = None
    """Randomised cars."""
    obstacles: int = 6
    """Boxes or bots in obstacle avoidance."""
    bots: bool = False
    """Bot cars instead of boxes."""
    episode_s: float = 40.0
    """Longest episode [s]."""
    save_every: int = 4
    """Updates between two save points, from which a killed run goes on; the rows start anew there,
    in a run that was never interrupted too, so that both end in the same weights."""

    def __post_init__(self) -> None:
        if not 1 <= self.num_worlds <= 65_536:
            raise ConfigError(f"num_worlds is {self.num_worlds}: give 1 to 65536")
        batch = self.num_worlds * self.ppo.steps
        if batch < self.ppo.mini_batches:
            raise ConfigError(
                f"{batch} decisions cannot be split into {self.ppo.mini_batches} mini-batches: "
                "give more worlds or steps"
            )
        if not 0 <= self.seed < 2**31:
            raise ConfigError(f"seed is {self.seed}: give 0 to {2**31 - 1}")
        if not 0 <= self.tutor <= 0.9:
            raise ConfigError(
                f"the tutor's share of the budget is {self.tutor}: give 0, which is none, to 0.9"
            )
        if self.save_every < 1:
            raise ConfigError(f"save_every is {self.save_every}: give at least 1")

    @property
    def samples(self) -> int:
        """Decisions between two updates."""
        return self.num_worlds * self.ppo.steps

    def with_ppo(self, **changes: object) -> TrainConfig:
        """Return the settings with some of the learner's changed."""
        return replace(self, ppo=replace(self.ppo, **changes))  # type: ignore
